"""STOP reaches the station whatever is open on the page: by mouse, touch and keyboard, and over a broken network."""

from collections.abc import Callable

import pytest
from playwright.sync_api import Browser, Page

from tests.harness.chromium import PATIENCE
from tests.harness.serving import Served
from tests.harness.waiting import until

HOLD = {"trajectory": {"kind": "hold"}, "duration": 600.0}


def tab(page: Page, name: str) -> None:
    page.locator(f"#tab-{name}").click()


def button(page: Page, name: str) -> None:
    page.get_by_role("button", name=name).click()


def home(_station: Served, page: Page) -> None:
    tab(page, "devices")
    button(page, "Home…")


def operator(_station: Served, page: Page) -> None:
    button(page, "Take control")


def calibrate(_station: Served, page: Page) -> None:
    tab(page, "calibrate")
    page.locator("#calibrate .card").first.click()
    button(page, "Start: ")


def experiment(station: Served, page: Page) -> None:
    """It asks before it goes to another pose."""
    station.post("/api/jog", {"space": "joints", "velocity": [0.3, 0.0, 0.0]})
    station.wait_for(lambda s: s["state"] == "READY" and abs(s["joints"]["outer_rotation"]) > 0.02)
    station.rest.delete("/api/operator")
    tab(page, "start")
    page.locator(".card", has_text="Fig. 4").click()
    button(page, "Start experiment")


def delete(station: Served, page: Page) -> None:
    open_new_run(station, page)
    button(page, "Delete…")


def open_new_run(station: Served, page: Page) -> None:
    """What is recorded of a short run, in the tab Runs."""
    station.post("/api/start", HOLD | {"duration": 0.5})
    run = station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])["run"]["id"]
    station.rest.delete("/api/operator")
    tab(page, "runs")

    def opened() -> bool:
        if page.get_by_role("button", name="all runs").count():
            button(page, "all runs")
        page.locator("#runs .card").first.click()
        page.get_by_role("button", name="Delete…").wait_for()
        return run in page.locator("#runs").inner_text()

    until(opened)


@pytest.mark.parametrize("ask", [home, operator, calibrate, experiment, delete])
def test_stop_and_the_state_are_reached_under_every_dialog(
    station: Served, page: Page, ask: Callable[[Served, Page], None]
) -> None:
    page.locator("#operator", has_text="No operator").wait_for()
    ask(station, page)
    question = page.get_by_role("dialog")
    question.wait_for()
    for press in (page.locator("#stop").click, lambda: page.keyboard.press("Shift+Space")):
        press()
        page.locator("#state", has_text="STOPPED").wait_for()
        assert question.is_visible()
        station.ready()
        page.locator("#state", has_text="READY").wait_for()
    page.keyboard.press("Escape")
    question.wait_for(state="hidden")
    assert station.status()["state"] == "READY"  # it answered the question and nothing else


def test_a_finger_stops_under_a_dialog(station: Served, browser: Browser) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    context.set_default_timeout(PATIENCE)
    try:
        page = context.new_page()
        page.route("**/viser/**", lambda route: route.abort())
        page.goto(station.url)
        page.locator("#operator", has_text="No operator").wait_for()
        page.get_by_role("button", name="Take control").tap()
        page.get_by_role("dialog").wait_for()
        page.locator("#stop").tap()
        page.locator("#state", has_text="STOPPED").wait_for()
    finally:
        context.close()


def test_a_stop_is_repeated_until_it_is_acknowledged_and_the_page_says_so(station: Served, page: Page) -> None:
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    page.context.set_offline(True)
    try:
        page.locator("#stop").click()
        page.locator("#alarm", has_text="STOP is not acknowledged: sent 2 times").wait_for()
        assert station.status()["state"] == "RUNNING"
    finally:
        page.context.set_offline(False)
    station.wait_for(lambda s: s["state"] == "STOPPED")
    page.locator("#alarm", has_text="STOP was taken: acknowledged after").wait_for()
    page.get_by_role("button", name="Close").click()
    assert page.locator("#alarm").is_hidden()


def test_escape_stops_what_moves(station: Served, page: Page) -> None:
    page.locator("#tab-start").focus()
    page.keyboard.press("Escape")
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    assert station.status()["state"] == "RUNNING"
    page.keyboard.press("Escape")
    page.locator("#state", has_text="STOPPED").wait_for()


def test_a_text_box_takes_a_space_while_nothing_moves_and_stops_what_does(station: Served, page: Page) -> None:
    tab(page, "runs")
    if page.get_by_role("button", name="all runs").count():
        button(page, "all runs")
    search = page.get_by_label("search")
    search.fill("A")
    search.press("Shift+Space")
    assert search.input_value() == "A "
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    assert station.status()["state"] == "RUNNING"
    search.press("Shift+Space")
    page.locator("#state", has_text="STOPPED").wait_for()
    search.fill("")


def test_the_keys_work_in_a_report_s_frame(station: Served, page: Page) -> None:
    open_new_run(station, page)
    button(page, "Replay")
    page.locator("#cover", has_text="this is not live").wait_for()
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    page.frame_locator("#cover iframe").locator("button").first.press("Shift+Space")
    page.locator("#state", has_text="STOPPED").wait_for()
    button(page, "live scene")
