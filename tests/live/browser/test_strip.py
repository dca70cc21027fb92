"""The strip above the tabs shows current values or none, and the result of a finished run."""

import re

from playwright.sync_api import Page, expect

from tests.harness.chromium import open_tab, press_until, wait_until_current
from tests.harness.serving import Served

#: Run that lasts longer than the test, which stops the run after all checks.
HELD = {
    "trajectory": {"kind": "hold"},
    "load": {"kind": "trapezoid", "magnitude": 0.3, "rise": 0.5},
    "duration": 3600.0,
}
CELL = "(nth) => document.querySelectorAll('#strip output')[nth]?.textContent ?? 'loading 0'"
NUMBER = f"(nth) => /^[0-9.]+ m?[mN]$/.test(({CELL})(nth))"
EMPTY = f"(nth) => !/[0-9]/.test(({CELL})(nth))"
ERROR, _, FORCE, DEFLECTION, LEFT = range(5)  # the second value, the direction, is hidden if no direction is desired


def test_value_strip_shows_values_during_a_motion_and_the_result_at_its_end(page: Page, station: Served) -> None:
    page.wait_for_function(EMPTY, arg=ERROR)  # without a desired path there is no error
    page.wait_for_function(NUMBER, arg=FORCE)
    kept = [page.locator(name) for name in ("#strip", "#ended", "#tabs")]  # none moves, whatever is shown in it
    places = [one.bounding_box() for one in kept]
    started = station.post("/api/start", HELD)
    assert started.status_code == 202, started.text
    station.rest.delete("/api/operator")
    for cell in (ERROR, FORCE, DEFLECTION):
        page.wait_for_function(NUMBER, arg=cell)
    page.wait_for_function(f"(nth) => /^[0-9]+:[0-9]{{2}}$/.test(({CELL})(nth))", arg=LEFT)
    expect(page.locator("#strip span").first).to_have_text("true error")
    note = page.locator("#strip > div").first.locator("span").last
    expect(note).to_have_text(re.compile(r"^tracker\serror [0-9.]+\smm$"))
    assert note.evaluate("note => note.scrollWidth <= note.clientWidth")
    assert [one.bounding_box() for one in kept] == places
    expect(page.locator("#tip p")).to_have_text(re.compile(r"^tracker error [0-9.]+ mm$"))
    expect(page.locator("#now .chart-head").first).to_have_text(re.compile(r"Error \[mm\]tracker error .*true error "))
    station.post("/api/stop")
    page.locator(
        "#ended", has_text=re.compile(r"■ stopped by .* · [0-9.]+\smm largest true error, RMS [0-9.]+\smm")
    ).wait_for()
    page.wait_for_function(EMPTY, arg=ERROR)
    assert [one.bounding_box() for one in kept] == places
    page.locator("#ended").get_by_role("button", name="Result").click()
    page.locator("#runs .result", has_text="largest").wait_for()


def test_jog_buttons_keep_their_place_below_the_result_of_the_last_run(page: Page, station: Served) -> None:
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 1.0}).status_code == 202
    page.locator("#ended", has_text="● complete").get_by_role("button", name="Result").wait_for()  # of this run
    station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])
    station.rest.delete("/api/operator")
    open_tab(page, "jog")
    button = page.get_by_role("button", name="x plus: hold to move")
    wait_until_current(page)
    button.hover()  # this may scroll the tab
    place = button.bounding_box()

    def press() -> None:
        page.mouse.up()
        page.mouse.down()

    try:
        press_until(page, press, page.locator("#state", has_text="RUNNING").is_visible)
        expect(page.locator("#ended")).to_be_visible()
        assert button.bounding_box() == place
        expect(page.locator("#run-progress")).to_be_hidden()
    finally:
        page.mouse.up()
    page.locator("#state", has_text="READY").wait_for()


def test_value_strip_hides_the_force_while_its_sensor_is_silent(page: Page, station: Served) -> None:
    page.wait_for_function(NUMBER, arg=FORCE)
    station.post("/api/faults", {"faults": [{"kind": "mute", "device": "inner"}]})
    page.wait_for_function(EMPTY, arg=FORCE)
    page.wait_for_function(EMPTY, arg=DEFLECTION)


def test_value_strip_hides_the_deflection_while_the_tip_is_not_measured(page: Page, station: Served) -> None:
    page.wait_for_function(NUMBER, arg=DEFLECTION)
    station.post("/api/faults", {"faults": [{"kind": "lose_tool", "device": "tracker"}]})
    page.locator("#state", has_text="HOLD").wait_for()
    page.wait_for_function(EMPTY, arg=DEFLECTION)
    page.wait_for_function(NUMBER, arg=FORCE)  # the force is measured still
    page.locator("#says", has_text="the motors are on.").wait_for()
    page.locator("#next", has_text="Press Reset to make the station ready. Reset moves nothing.").wait_for()
