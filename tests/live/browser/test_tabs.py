"""The tabs as an operator uses them, without the scene, whose drawing needs a whole processor."""

import re
import time
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.harness.chromium import (
    bare_page,
    open_tab,
    press_until,
    press_until_asked,
    press_until_sent,
    wait_until_loaded,
)
from tests.harness.serving import Served
from tests.harness.waiting import NET, until

Picture = Callable[[Page, str], None]
CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.003, "period": 4.0}, "duration": 2.0}


def tab(page: Page, name: str) -> None:
    open_tab(page, name)
    if name == "start" and page.get_by_role("button", name="all motions").count():
        page.get_by_role("button", name="all motions").click()
        page.locator(".card").first.wait_for()


def joints(station: Served) -> list[float]:
    return list(station.status()["joints"].values())


def hold(page: Page, station: Served, button: str, moved: Callable[[dict[str, Any]], bool], key: str = "") -> None:
    """Press a button of the page until the robot has moved; it then stays pressed, by the mouse or by a key.

    The page ends the jog when the status is older than half a second, which happens on a busy machine.
    """
    control, end = page.get_by_role("button", name=button), time.monotonic() + NET
    while time.monotonic() < end:
        if key:
            control.focus()
            page.keyboard.down(key)
        else:
            control.hover()
            page.mouse.down()
        while "held" in (control.get_attribute("class") or "").split() and time.monotonic() < end:
            if moved(station.status()):
                return
        page.keyboard.up(key) if key else page.mouse.up()
    raise AssertionError(f"'{button}' moves nothing")


# ---- run


def test_page_starts_an_experiment_after_its_start_pose_is_confirmed(
    page: Page, station: Served, picture: Picture
) -> None:
    tab(page, "start")
    page.locator(".card img").first.wait_for()
    page.wait_for_function("() => document.querySelector('.card img').naturalWidth > 0")
    picture(page, "run")
    tab(page, "jog")
    hold(page, station, "inner rotation plus: hold to move", lambda s: s["joints"]["inner_rotation"] > 1.5708 + 0.03)
    page.mouse.up()
    tab(page, "start")
    page.locator(".card", has_text="Fig. 10").click()
    page.get_by_label("case").select_option("feedforward")
    page.locator("#start", has_text="inner rotation 90").wait_for()
    start = page.get_by_role("button", name="Start experiment")
    question = press_until_asked(page, start.click)
    question.get_by_text("start pose").wait_for()
    picture(page, "confirm")
    question.get_by_role("button", name="Cancel").click()
    assert station.status()["state"] == "READY"
    press_until_asked(page, start.click)
    question.get_by_role("button", name="Start").click()
    status = station.wait_for(lambda s: s["state"] == "RUNNING")
    assert status["run"]["title"].startswith("fig10: ")
    page.locator("#run-left", has_text="left of 3:20").wait_for()
    page.locator("#stop").click()
    station.wait_for(lambda s: s["state"] == "STOPPED")
    page.get_by_role("button", name="all motions").click()


def test_free_motion_form_has_units_and_bounds_and_runs_as_set(page: Page, station: Served, picture: Picture) -> None:
    tab(page, "start")
    page.locator(".card", has_text="Move the tip along a circle").click()
    radius = page.locator("#start").get_by_label("radius")
    expect(page.locator("#start").get_by_text("mm 0 … 100")).to_have_count(1)
    picture(page, "free_motion")
    radius.fill("1000")
    page.get_by_role("button", name="Start motion").click()
    radius.and_(page.locator(":invalid")).wait_for()
    assert station.status()["state"] == "READY"
    radius.fill("4")
    page.locator("#start").get_by_label("duration").fill("30")
    page.get_by_label("Load on the simulated tip").select_option("constant")
    press_until_sent(page, page.get_by_role("button", name="Start motion").click)
    status = station.wait_for(lambda s: s["state"] == "RUNNING" and s["run"]["phase"] == "moving")
    assert status["run"]["duration"] == 30.0
    page.get_by_role("button", name="Motions", exact=True).click()
    expect(page.get_by_role("button", name="Start motion")).to_be_disabled()
    station.wait_for(lambda s: s["force"][0] > 0.1)
    station.post("/api/stop")
    page.get_by_role("button", name="all motions").click()


def test_run_with_a_load_that_is_too_fast_starts_with_a_warning(page: Page, station: Served) -> None:
    tab(page, "start")
    page.locator(".card", has_text="Keep the tip where it is").click()
    page.locator("#start").get_by_label("duration").first.fill("5")
    page.get_by_label("Load on the simulated tip").select_option("tap")
    press_until_sent(page, page.get_by_role("button", name="Start motion").click)
    page.locator(".note", has_text="started, but the joints cannot compensate load tap").wait_for()
    station.wait_for(lambda s: s["state"] == "RUNNING" and s["run"]["phase"] == "moving")
    station.post("/api/stop")
    page.get_by_role("button", name="all motions").click()


# ---- jog


@pytest.mark.parametrize("ending", ["release", "leave", "blur", "hide"])
def test_jog_stops_when_its_button_is_released_or_the_page_is_left(page: Page, station: Served, ending: str) -> None:
    tab(page, "jog")
    before = joints(station)
    plus = "outer rotation plus: hold to move"
    hold(page, station, plus, lambda s: s["joints"]["outer_rotation"] > before[0] + 0.02)
    match ending:
        case "release":
            page.mouse.up()
        case "leave":
            page.mouse.move(900, 30)
        case "blur":
            page.evaluate("() => window.dispatchEvent(new Event('blur'))")
        case _:
            page.evaluate(
                """() => { Object.defineProperty(document, 'hidden', {value: true, configurable: true});
                           document.dispatchEvent(new Event('visibilitychange')); delete document.hidden; }"""
            )
    still = station.rest_of_joints()
    page.wait_for_timeout(500)
    assert joints(station) == still
    page.mouse.up()


def test_keyboard_jogs_the_tip_in_the_jog_tab(page: Page, station: Served, picture: Picture) -> None:
    tab(page, "jog")
    before = station.status()["tip_true"]
    hold(page, station, "z minus: hold to move", lambda s: s["tip_true"][2] < before[2] - 0.002, "Space")
    picture(page, "jog")
    page.keyboard.up("Space")
    station.rest_of_joints()
    after = station.status()["tip_true"]
    assert abs(after[0] - before[0]) + abs(after[1] - before[1]) < abs(after[2] - before[2])


def test_closing_the_page_stops_a_jog(station: Served, browser: Browser) -> None:
    with bare_page(browser, station) as page:
        tab(page, "jog")
        before = joints(station)
        minus = "outer rotation minus: hold to move"
        hold(page, station, minus, lambda s: s["joints"]["outer_rotation"] < before[0] - 0.02)
    station.rest_of_joints()


# ---- devices


def test_devices_tab_shows_details_and_offers_homing_only_after_the_path_is_confirmed_clear(
    page: Page, station: Served, picture: Picture
) -> None:
    tab(page, "devices")
    page.locator("#devices legend", has_text="tracker").wait_for()
    page.locator("#devices summary").first.click()
    page.locator("#devices td", has_text="serial").first.wait_for()
    page.locator("#devices", has_text="wrench_raw.inner_fx [N]").wait_for()
    page.locator("#devices", has_text="Robot: paper, 3 motors.").wait_for()
    page.locator("#devices", has_text="balanced_pair (6 motors)").wait_for()
    picture(page, "devices")
    press_until_sent(page, page.get_by_role("button", name="Zero the force sensors").click, "/api/tare")
    page.locator(".note.good", has_text="reads zero").first.wait_for()
    dialog = press_until_asked(page, page.locator("#devices").get_by_role("button", name="Home…").click)
    expect(dialog.get_by_role("button", name="Home", exact=True)).to_be_disabled()
    picture(page, "home")
    # test_fewer_devices.py homes a robot that starts near its home sensors.
    dialog.get_by_role("checkbox").check()
    expect(dialog.get_by_role("button", name="Home", exact=True)).to_be_enabled()
    dialog.get_by_role("button", name="Cancel").click()
    assert station.status()["state"] == "READY"


def test_axis_direction_is_checked_against_the_model(page: Page, station: Served) -> None:
    tab(page, "devices")

    def turn() -> None:
        before = joints(station)
        hold(page, station, "outer rotation +", lambda s: s["joints"]["outer_rotation"] > before[0] + 0.08)
        page.mouse.up()

    # The page asks to hold longer if it has ended the jog, or if its status is still that of a shorter motion.
    press_until(page, turn, page.locator("#devices", has_text="✓ right direction").is_visible)


# ---- plots


def test_plots_of_the_page_can_be_chosen_paused_and_zoomed(page: Page, station: Served, picture: Picture) -> None:
    tab(page, "plots")
    charts = page.locator("#plots .chart")
    expect(charts).to_have_count(3)
    page.get_by_role("button", name="timing").click()
    expect(charts).to_have_count(4)
    page.get_by_role("button", name="deflection").click()
    station.post("/api/start", CIRCLE | {"load": {"kind": "constant", "magnitude": 0.3}, "duration": 6.0})
    station.wait_for(lambda s: s["state"] == "READY")
    page.locator("#ended").get_by_role("button", name="Result").wait_for()  # it moves the charts down
    picture(page, "plots")
    page.get_by_role("button", name="Pause").click()
    force = page.get_by_role("img", name="Force at the tip over time")
    pixels = "canvas => canvas.toDataURL()"
    still = force.evaluate(pixels)
    page.wait_for_timeout(600)
    assert force.evaluate(pixels) == still
    force.scroll_into_view_if_needed()
    box = force.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 150, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 60)
    page.mouse.up()
    until(lambda: force.evaluate(pixels) != still)
    page.get_by_role("button", name="Whole time").click()
    page.get_by_role("button", name="Resume").click()
    until(lambda: force.evaluate(pixels) != still)


# ---- runs


def test_runs_tab_lists_annotates_replays_and_compares_runs(page: Page, station: Served, picture: Picture) -> None:
    for _ in range(2):
        station.post("/api/start", CIRCLE)
        station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])
    tab(page, "runs")
    cards = page.locator("#runs .card", has_text="circle, radius 3 mm, period 4 s")
    cards.nth(1).wait_for()
    page.get_by_text("Tick two runs to compare them").wait_for()
    expect(cards.first.get_by_role("img", name="complete")).to_be_visible()
    expect(cards.first).to_contain_text(" · 2 s")
    assert all(float(number) > 0.0 for number in cards.first.locator(".number").all_inner_texts())
    picture(page, "runs")
    cards.first.click()
    page.locator(".result .ended", has_text="complete").wait_for()
    page.locator(".result svg.curve").nth(1).wait_for()
    page.locator(".result", has_text=re.compile(r"Largest distance at \d+(\.\d+)? s\.")).wait_for()
    picture(page, "result")
    page.locator("#numbers summary").click()
    page.locator("#numbers td", has_text="5001 numbers").first.wait_for()
    assert page.locator("#runs tr").count() < 100  # a histogram is one row, and not one row per bin
    page.get_by_label("notes").fill("a new coil")
    page.get_by_role("button", name="Save notes").click()
    page.locator(".note.good", has_text="saved").wait_for()
    with page.expect_download() as download:
        page.get_by_role("link", name="run.mcap").click()
    assert download.value.path().read_bytes().startswith(b"\x89MCAP0\r\n")
    page.get_by_role("button", name="Replay").click()
    page.locator("#cover", has_text="this is not live").wait_for()
    page.frame_locator("#cover iframe").locator("canvas").first.wait_for()
    picture(page, "replay")
    page.get_by_role("button", name="live scene").click()
    page.get_by_role("button", name="all runs").click()
    page.locator("#runs .card", has_text="a new coil").wait_for()
    for box in page.locator("#runs input[type=checkbox]").all()[:2]:
        box.check()
    page.get_by_role("button", name="Compare two").click()
    page.locator(".result svg.curve").nth(1).wait_for()
    # the curves of both runs are in one diagram
    expect(page.locator(".result svg.curve").first.locator("polyline")).to_have_count(2)
    assert page.locator("#comparison tr").count() > 5
    picture(page, "compare")
    page.get_by_role("button", name="all runs").click()


# ---- faults


def test_injected_fault_is_shown_explained_and_reset(page: Page, station: Served, picture: Picture) -> None:
    station.post("/api/start", CIRCLE | {"duration": 60.0})
    station.wait_for(lambda s: s["run"]["phase"] == "moving")
    station.rest.delete("/api/operator")
    tab(page, "faults")
    page.get_by_label("fault", exact=True).select_option("lose_tool")
    page.locator("#faults").get_by_label("duration [s]").fill("1.5")
    page.locator("#faults", has_text="The tracker does not see the coil at the tip.").wait_for()
    press_until_sent(page, page.get_by_role("button", name="Inject").click, "/api/faults")
    page.locator("#state", has_text="HOLD").wait_for()
    page.locator("#faults", has_text="What to do").wait_for()
    picture(page, "faults")
    page.locator("#lights li[title*='tracker: connected, nothing is wrong'] .light[data-severity='0']").wait_for()
    press_until_sent(page, page.locator("#faults").get_by_role("button", name="Reset").click, "/api/reset")
    page.locator("#state", has_text="READY").wait_for()
    page.locator("#faults td", has_text=re.compile("^Inject a fault.*lose_tool")).first.wait_for()


# ---- keyboard only, colour blindness, small screens


def test_keyboard_reaches_every_control_of_the_page(page: Page, station: Served) -> None:
    page.locator("#tab-start").focus()
    for names in (("jog", "plots", "runs", "cameras", "bench", "start"), ("calibrate", "faults", "devices")):
        for name in names:
            page.keyboard.press("ArrowRight")
            expect(page.locator(f"#{name}")).to_be_visible()
            expect(page.locator(f"#tab-{name}")).to_be_focused()
        open_tab(page, "devices")
    open_tab(page, "start")
    page.locator("#stop").focus()
    seen = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.id || document.activeElement.className"))
    assert {"operator-act", "tab-start", "card", "divider"} <= seen
    station.post("/api/start", CIRCLE | {"duration": 60.0})
    page.locator("#stop").focus()
    page.keyboard.press("Enter")
    station.wait_for(lambda s: s["state"] == "STOPPED")


@pytest.mark.parametrize(("width", "height"), [(1280, 720), (820, 1180), (390, 844), (720, 450)])
def test_page_tabs_fit_small_screens(page: Page, width: int, height: int, picture: Picture) -> None:
    page.set_viewport_size({"width": width, "height": height})
    try:
        for name in ("start", "jog", "devices", "plots", "runs", "faults"):
            tab(page, name)
            wide = page.evaluate(
                f"document.getElementById('{name}').scrollWidth - document.getElementById('{name}').clientWidth"
            )
            assert wide <= 1, name
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.mouse.wheel(0, 2000)  # low windows scroll below STOP
        box = page.locator("#stop").bounding_box()
        assert box is not None
        assert 0 <= box["x"] < 12
        assert 0 <= box["y"] < 12
        assert box["width"] >= 120
        assert box["height"] >= 44
        page.evaluate("scrollTo(0, 0)")
        tab(page, "jog")
        if page.locator("#welcome").count():
            page.locator("#welcome").get_by_role("button", name="Close").click()
        jog = page.locator("#jog").bounding_box()
        assert jog is not None
        assert jog["height"] >= 0.45 * height
        picture(page, f"screen_{width}")
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})


def test_width_of_the_controls_is_set_by_keys_and_pointer_and_kept(page: Page) -> None:
    panel, divider = page.locator("#panel"), page.get_by_role("separator", name="width of the controls")

    def width() -> float:
        box = panel.bounding_box()
        assert box is not None
        return box["width"]

    usual = width()
    divider.focus()
    page.keyboard.press("ArrowLeft")
    wider = width()
    assert wider > usual
    page.reload()
    page.locator("#state", has_text="READY").wait_for()
    wait_until_loaded(page)
    assert width() == wider
    page.mouse.move(1280 - wider - 2, 400)
    page.mouse.down()
    page.mouse.move(1280 - usual - 100, 400)
    page.mouse.up()
    until(lambda: abs(width() - usual - 100) < 3)
    divider.dblclick()
    assert width() == usual
