"""First visit, help, command palette, and the title of the page; STOP works above all of them."""

from collections.abc import Callable

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.harness.chromium import VISITED, bare_page, press_escape, press_until, press_until_sent, wait_until_loaded
from tests.harness.serving import Served

HOLD = {"trajectory": {"kind": "hold"}, "duration": 600.0}


def help_dialog(page: Page) -> None:
    page.locator("#tab-start").focus()
    page.keyboard.press("?")
    page.get_by_role("dialog", name="Help").wait_for()


def palette(page: Page) -> None:
    page.keyboard.press("Control+k")
    page.get_by_role("combobox", name="action").wait_for()


def choose(page: Page, letters: str, name: str) -> None:
    """Carry out the action of the palette that some letters find."""
    palette(page)
    page.keyboard.type(letters)
    page.get_by_role("option", name=name).wait_for()
    press_until(page, lambda: page.keyboard.press("Enter"), page.locator("#palette").is_hidden)


@pytest.mark.parametrize("opened", [help_dialog, palette])
def test_stop_key_and_escape_stop_a_motion_while_a_dialog_is_open(
    page: Page, station: Served, opened: Callable[[Page], None]
) -> None:
    opened(page)
    for press in (lambda: page.keyboard.press("Shift+Space"), lambda: press_escape(page)):
        station.ready()
        station.post("/api/start", HOLD)
        page.locator("#state", has_text="RUNNING").wait_for()
        press()
        page.locator("#state", has_text="STOPPED").wait_for()
        expect(page.locator("dialog[open]")).to_be_visible()
    station.ready()
    page.locator("#state", has_text="READY").wait_for()
    press_escape(page)  # nothing moves
    page.locator("dialog[open]").wait_for(state="hidden")
    assert station.status()["state"] == "READY"


def test_help_mark_at_the_error_explains_the_true_and_the_measured_tip(page: Page, station: Served) -> None:
    page.get_by_role("button", name="explain true and tracker").click()
    page.get_by_role("dialog", name="Help").get_by_text("only a virtual lab knows it").wait_for()
    press_escape(page)
    page.get_by_role("dialog", name="Help").wait_for(state="hidden")
    assert station.status()["state"] == "READY"


def test_palette_carries_out_the_action_found_by_some_letters(page: Page, station: Served) -> None:
    palette(page)
    page.keyboard.type("op plot")
    page.keyboard.press("Enter")
    page.locator("#plots").wait_for()
    palette(page)
    page.keyboard.type("fig10")
    page.get_by_role("option", name="Experiment fig10").wait_for()
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Start experiment").wait_for()
    choose(page, "case fig10 feedf", "Case fig10")
    page.get_by_label("case").get_by_role("option", selected=True).wait_for(state="attached")
    expect(page.get_by_label("case")).to_have_value("feedforward")
    page.get_by_role("button", name="all motions").click()
    assert station.status()["state"] == "READY"


def test_palette_shows_why_an_action_is_not_possible_now_and_does_not_carry_it_out(page: Page, station: Served) -> None:
    palette(page)
    page.keyboard.type("reset")
    page.get_by_role("option", name="not while READY").first.wait_for()
    page.keyboard.press("Enter")
    expect(page.get_by_role("combobox", name="action")).to_be_visible()
    station.post("/api/operator", {"take_over": True})
    page.get_by_role("option", name="is operator: take over first").first.wait_for()
    station.rest.delete("/api/operator")
    page.get_by_role("option", name="not while READY").first.wait_for()
    press_escape(page)
    page.locator("dialog[open]").wait_for(state="hidden")


def test_palette_takes_and_releases_control(page: Page, station: Served) -> None:
    station.rest.delete("/api/operator")
    page.locator("#operator", has_text="No operator").wait_for()
    choose(page, "take control", "Take control")
    page.get_by_role("dialog").get_by_label("your name").fill("Ada")
    page.keyboard.press("Enter")
    page.locator("#operator", has_text="You are operator").wait_for()
    assert station.status()["operator"]["name"] == "Ada"
    choose(page, "release", "Release control")
    station.wait_for(lambda s: s["operator"]["name"] is None)


def test_palette_stops_a_motion(page: Page, station: Served) -> None:
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    choose(page, "stop", "STOP every axis")
    station.wait_for(lambda s: s["state"] == "STOPPED")


def test_page_title_shows_the_state_and_the_run(page: Page, station: Served) -> None:
    station.post("/api/start", HOLD)
    page.wait_for_function("() => / % · .* left · hold/.test(document.title)")
    station.post("/api/stop")
    page.wait_for_function("() => document.title === 'STOPPED'")
    station.ready()
    page.wait_for_function("() => document.title === 'ctr-station'")


def test_first_visit_offers_the_demo_and_a_tour_that_can_be_left(first_visit: Page, station: Served) -> None:
    page = first_visit
    page.get_by_role("button", name="Show me around").click()
    page.locator("#stop.pointed-at").wait_for()
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
    page.get_by_role("button", name="Skip").click()
    expect(page.locator("#welcome")).to_have_count(0)
    page.reload()
    wait_until_loaded(page)
    expect(page.locator("#welcome")).to_have_count(0)


def test_tour_is_left_by_escape_at_rest_and_escape_stops_a_motion_first(first_visit: Page, station: Served) -> None:
    page = first_visit
    page.get_by_role("button", name="Show me around").click()
    page.get_by_role("button", name="Next").click()
    for key in ("Shift+Space", "Escape"):
        station.post("/api/start", HOLD)
        page.locator("#state", has_text="RUNNING").wait_for()
        page.keyboard.press(key)
        page.locator("#state", has_text="STOPPED").wait_for()
        expect(page.get_by_text("2 of 3")).to_be_visible()
        station.ready()
        page.locator("#state", has_text="READY").wait_for()
    press_escape(page)
    page.locator("#welcome").wait_for(state="detached")
    expect(page.locator(".pointed-at")).to_have_count(0)
    assert station.status()["state"] == "READY"


SPY = """
window.noted = []; window.tones = 0;
const Original = window.Notification, start = OscillatorNode.prototype.start;
window.Notification = class extends Original {
  constructor(title, options) { super(title, options); noted.push(`${title}: ${options.body}`); }
};
OscillatorNode.prototype.start = function (...at) { tones += 1; return start.apply(this, at); };
Object.defineProperty(document, 'hidden', {get: () => window.away === true, configurable: true});
"""


def test_end_of_a_run_and_a_stop_are_notified_by_title_icon_sound_and_browser(
    station: Served, browser: Browser
) -> None:
    with bare_page(browser, station, script=VISITED + SPY, permissions=["notifications"]) as page:
        help_dialog(page)
        for name in ("sound at the end", "notification of the browser"):
            page.get_by_role("checkbox", name=name).check()
        page.get_by_role("button", name="Close", exact=True).click()
        ready_icon, tones = page.locator("#icon").get_attribute("href"), page.evaluate("tones")
        page.evaluate("window.away = true")
        # The page reports the end only of a run that it has seen, which takes a busy computer some seconds.
        station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 8.0})
        page.wait_for_function("() => document.title.startsWith('complete · hold')")
        page.wait_for_function("() => noted.length === 1 && noted[0].startsWith('The run is complete: hold')")
        page.wait_for_function("tones => window.tones > tones", arg=tones)
        page.evaluate(
            "() => { window.away = false; document.dispatchEvent(new Event('visibilitychange')); window.away = true; }"
        )
        page.wait_for_function("() => document.title === 'ctr-station'")
        station.post("/api/start", HOLD)
        page.locator("#state", has_text="RUNNING").wait_for()
        page.locator("#stop").click()
        page.wait_for_function("() => noted.length === 2 && noted[1].startsWith('STOPPED: ')")
        assert page.title() == "STOPPED"
        expect(page.locator("#icon")).not_to_have_attribute("href", ready_icon)


def test_demo_of_the_first_visit_starts_with_one_press(first_visit: Page, station: Served) -> None:
    station.rest.delete("/api/operator")
    press_until_sent(first_visit, first_visit.get_by_role("button", name="Run the demo").click)
    status = station.wait_for(lambda s: s["state"] == "RUNNING")
    assert status["run"]["title"].startswith("demo")
