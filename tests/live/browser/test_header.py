"""The header without the scene: it shows the true state and stops the robot even if other parts fail."""

import signal

from playwright.sync_api import Browser, Page, expect

from tests.harness.chromium import SIZE, bare_page, press_until_sent, wait_until_current
from tests.harness.contrast import CONTRAST
from tests.harness.serving import Served, serving

HOLD = {"trajectory": {"kind": "hold"}, "duration": 60.0}
DASH = "\N{EN DASH}"  # where the page has no current value
#: A short run whose title no other run has.
SHORT = {"trajectory": {"kind": "sinusoid", "amplitude": 7e-4, "frequency": 1.0}, "duration": 0.5}
IN_ITS_TITLE = "0.7 mm"
#: The browser itself is busy, as with drawing the scene without a graphics card: each timer is late by 0.6 s.
BUSY = """() => {
    window.busy = setInterval(() => { const end = performance.now() + 600; while (performance.now() < end); }, 10);
}"""


def test_page_shows_fault_for_a_dead_control_process_and_reset_restarts_it(page: Page, station: Served) -> None:
    station.control_process().kill()
    page.locator("#state", has_text="FAULT").wait_for()
    page.locator("#says", has_text="signal 9").wait_for()
    station.wait_for(lambda s: s["age"] > 2.0)  # the control process sends nothing more, but Reset must stay usable
    wait_until_current(page)
    expect(page.locator("#silence")).to_be_hidden()
    press_until_sent(page, page.locator("#reset").click, "/api/reset")
    page.locator("#state", has_text="READY").wait_for()
    page.locator("#act button", has_text="Home").wait_for()


def test_nothing_looks_live_or_usable_while_the_station_does_not_answer(page: Page, station: Served) -> None:
    assert station.post("/api/start", SHORT).status_code == 202
    again = page.locator("#ended", has_text=IN_ITS_TITLE).get_by_role("button", name="Run again")
    again.wait_for()
    station.rest.delete("/api/operator")
    for width, height in ((1440, 900), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        station.ready()
        wait_until_current(page)
        station.process.send_signal(signal.SIGSTOP)
        try:
            page.locator("#state", has_text="NO ANSWER").wait_for()
            page.locator("#silence", has_text="The station does not answer").wait_for()
            assert set(page.locator("#strip > :not([hidden]) output").all_text_contents()) == {DASH}
            assert page.locator("#lights .light:not([data-severity='-1'])").count() == 0
            assert page.locator("#loop").text_content() == f"500 Hz, {DASH} missed"
            expect(again).to_be_disabled()
            expect(page.locator("#operator-act")).to_be_disabled()
            expect(page.locator("#act button:enabled")).to_have_count(0)
            colours = "(state) => [getComputedStyle(state).color, getComputedStyle(silence).backgroundColor]"
            state, alarm = page.locator("#state").evaluate(colours)
            assert state == alarm  # not the weaker grey of old values
        finally:
            station.process.send_signal(signal.SIGCONT)
        page.locator("#silence").wait_for(state="hidden")
        expect(page.locator("#operator-act")).to_be_enabled()
    page.set_viewport_size(SIZE)


def test_busy_browser_removes_the_report_of_silence_together_with_the_state(page: Page, station: Served) -> None:
    station.process.send_signal(signal.SIGSTOP)
    try:
        page.locator("#state", has_text="NO ANSWER").wait_for()
        page.evaluate(BUSY)
    finally:
        station.process.send_signal(signal.SIGCONT)
    try:
        page.wait_for_function("() => state.textContent !== 'NO ANSWER' && silence.hidden && age.hidden")
    finally:
        page.evaluate("clearInterval(window.busy)")


def test_page_marks_a_hanging_station_as_stale_and_reports_an_ended_one(browser: Browser) -> None:
    # The page is opened while the devices are connected.
    with serving(connected=False) as station, bare_page(browser, station) as page:
        page.locator(".card", has_text="Keep the tip where it is").click()
        start = page.locator("button:enabled", has_text="Start motion")
        start.wait_for()
        place = start.bounding_box()
        try:
            station.process.send_signal(signal.SIGSTOP)
            page.wait_for_function("() => document.body.classList.contains('stale')")
            start.click()
            page.locator("#notes", has_text="Not started").wait_for()
            page.locator("#silence", has_text="no data for").wait_for()
            page.locator("#age", has_text="no data for").wait_for()
            assert page.locator("button", has_text="Start motion").bounding_box() == place
        finally:
            station.process.send_signal(signal.SIGCONT)
        page.wait_for_function("() => !document.body.classList.contains('stale')")
        page.locator("#silence").wait_for(state="hidden")
        station.post("/api/start", HOLD)
        page.locator("#now").wait_for()
        station.process.send_signal(signal.SIGSTOP)
        try:
            page.locator("#state", has_text="NO ANSWER").wait_for()
            expect(page.locator("#now")).to_be_visible()
        finally:
            station.process.send_signal(signal.SIGCONT)
        station.end()
        page.locator("#state", has_text="NO ANSWER").wait_for()
        page.locator("#silence", has_text="The station does not answer").wait_for()
        page.locator("#next", has_text="start the station").wait_for()
        assert page.locator("#state").evaluate(CONTRAST) >= 4.5
        assert page.locator("#silence").evaluate(CONTRAST) >= 4.5
        expect(page.locator("#act button:enabled")).to_have_count(0)
        page.locator("#stop").click()
        page.locator("#alarm", has_text="Use the emergency stop").wait_for()
