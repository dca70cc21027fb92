"""STOP reaches the station whatever is open on the page: by mouse, touch and keyboard, and over a broken network."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.harness.chromium import bare_page, open_tab, press_escape, press_until, press_until_asked, wait_until_current
from tests.harness.serving import Served
from tests.harness.waiting import until

HOLD = {"trajectory": {"kind": "hold"}, "duration": 600.0}


def button(page: Page, name: str) -> None:
    page.get_by_role("button", name=name).click()


def home(_station: Served, page: Page) -> None:
    open_tab(page, "devices")
    press_until_asked(page, page.locator("#devices").get_by_role("button", name="Home…").click)


def operator(_station: Served, page: Page) -> None:
    press_until_asked(page, page.get_by_role("button", name="Take control").click)


def calibrate(_station: Served, page: Page) -> None:
    open_tab(page, "calibrate")
    page.locator("#calibrate .card").first.click()
    press_until_asked(page, page.get_by_role("button", name="Start: ").click)


def experiment(station: Served, page: Page) -> None:
    """Open the confirmation of an experiment that first goes to another pose."""

    def moved() -> bool:
        # One jog lasts 0.3 s, of which a busy control loop may use only a part.
        station.post("/api/jog", {"space": "joints", "velocity": [0.3, 0.0, 0.0]})
        return station.status()["joints"]["outer_rotation"] > 0.03  # signed: the jog must not end at zero

    until(moved)
    station.rest_of_joints()  # the last jog has ended
    station.wait_for(lambda s: s["state"] == "READY")
    station.rest.delete("/api/operator")
    open_tab(page, "start")
    page.locator(".card", has_text="Fig. 4").click()
    press_until_asked(page, page.get_by_role("button", name="Start experiment").click)


def delete(station: Served, page: Page) -> None:
    open_new_run(station, page)
    button(page, "Delete…")


def open_new_run(station: Served, page: Page) -> None:
    """Record a short run and open its page in the tab Runs."""
    station.post("/api/start", HOLD | {"duration": 0.5})
    run = station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])["run"]["id"]
    station.rest.delete("/api/operator")
    open_tab(page, "runs")
    if page.get_by_role("button", name="all runs").count():
        button(page, "all runs")
    page.locator(f"#runs .card[title='{run}']").click()  # the card of an older run may be replaced during the press
    page.get_by_role("button", name="Save notes").wait_for()


@pytest.mark.parametrize("ask", [home, operator, calibrate, experiment, delete])
def test_stop_button_and_state_are_usable_under_every_dialog(
    station: Served, page: Page, ask: Callable[[Served, Page], None]
) -> None:
    page.locator("#operator", has_text="No operator").wait_for()
    ask(station, page)
    question = page.get_by_role("dialog")
    question.wait_for()
    for press in (page.locator("#stop").click, lambda: page.keyboard.press("Shift+Space")):
        press()
        page.locator("#state", has_text="STOPPED").wait_for()
        expect(question).to_be_visible()
        station.ready()
        page.locator("#state", has_text="READY").wait_for()
    press_escape(page)
    question.wait_for(state="hidden")
    assert station.status()["state"] == "READY"  # Escape closed the question and did nothing else


def test_touch_on_the_stop_button_works_under_a_dialog(station: Served, browser: Browser) -> None:
    with bare_page(browser, station, viewport={"width": 390, "height": 844}, has_touch=True) as page:
        # A busy browser may drop the click of a touch; STOP needs only the first contact, so one touch is enough.
        press_until_asked(page, page.get_by_role("button", name="Take control").tap)
        page.locator("#stop").tap()
        page.locator("#state", has_text="STOPPED").wait_for()


@pytest.mark.parametrize("press", ["click", "Shift+Space", "Escape"])
def test_stop_works_while_the_page_has_no_data(station: Served, page: Page, press: str) -> None:
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    page.route("**/api/status", lambda route: route.abort())
    try:
        page.locator("#silence", has_text=re.compile("(trying|tries) again")).wait_for()  # after 1 s, and after 4 s
        page.locator("#tab-start").focus()
        if press == "click":
            page.locator("#stop").click()
        else:
            page.keyboard.press(press)
        station.wait_for(lambda s: s["state"] == "STOPPED")
    finally:
        page.unroute("**/api/status")
    page.locator("#state", has_text="STOPPED").wait_for()
    expect(page.locator("#alarm")).to_be_hidden()


def test_escape_key_in_the_page_stops_a_motion(station: Served, page: Page) -> None:
    page.locator("#tab-start").focus()
    press_escape(page)
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    assert station.status()["state"] == "RUNNING"
    page.keyboard.press("Escape")
    page.locator("#state", has_text="STOPPED").wait_for()


def test_shift_space_in_a_text_box_types_a_space_at_rest_and_stops_a_motion(station: Served, page: Page) -> None:
    open_tab(page, "runs")
    if page.get_by_role("button", name="all runs").count():
        button(page, "all runs")
    search = page.get_by_label("search")

    def type_space() -> None:
        station.ready()  # with old data, on a busy computer, the last press has been STOP
        wait_until_current(page)
        search.fill("A")
        search.press("Shift+Space")

    press_until(page, type_space, lambda: search.evaluate("box => box.value === 'A '"))
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    assert station.status()["state"] == "RUNNING"
    search.press("Shift+Space")
    page.locator("#state", has_text="STOPPED").wait_for()
    search.fill("")


def test_stop_keys_work_in_the_frame_of_a_replay(station: Served, page: Page) -> None:
    open_new_run(station, page)
    button(page, "Replay")
    page.locator("#cover", has_text="this is not live").wait_for()
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    page.frame_locator("#cover iframe").locator("button").first.press("Shift+Space")
    page.locator("#state", has_text="STOPPED").wait_for()
    button(page, "live scene")
