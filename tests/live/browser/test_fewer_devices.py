"""Benches without a tracker or force sensors from the page: from homing to the report."""

import pytest
from playwright.sync_api import Browser, Page

from tests.harness.chromium import bare_page, open_tab
from tests.harness.serving import Served, serving

NOTES = {
    ("sensors",): "no force sensors: the force is estimated",
    ("tracker",): "but no tracker: the loaded model computes the tip",
    ("tracker", "sensors"): "stages alone",
}
LIGHTS = {"stages": "stages", "tracker": "tracker", "sensors": "force sensors"}


def home(page: Page) -> None:
    page.locator("#devices").get_by_role("button", name="Home…").click()
    page.get_by_role("dialog").get_by_role("checkbox").check()
    page.get_by_role("dialog").get_by_role("button", name="Home", exact=True).click()
    page.locator("#state", has_text="HOMING").wait_for()
    page.locator("#state", has_text="READY").wait_for()


def circle(page: Page, station: Served) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="Move the tip along a circle").click()
    page.locator("#start").get_by_label("radius").fill("4")
    page.locator("#start").get_by_label("period").fill("4")
    page.locator("#start").get_by_label("duration").fill("4")
    page.get_by_role("button", name="Start motion").click()
    station.wait_for(lambda s: s["phase"] == "moving")
    station.wait_for(lambda s: s["state"] == "READY")


@pytest.mark.parametrize("missing", NOTES)
def test_page_leads_a_smaller_bench_from_homing_to_the_report(browser: Browser, missing: tuple[str, ...]) -> None:
    with serving(*(text for kind in missing for text in ("--without", kind))) as station:
        station.ready()
        with bare_page(browser, station) as page:
            lights = page.locator("#lights").inner_text()
            for kind, name in LIGHTS.items():
                assert (name in lights) == (kind not in missing)
            open_tab(page, "devices")
            page.locator("#devices", has_text=NOTES[missing]).wait_for()
            zero = page.get_by_role("button", name="Zero the force sensors")
            assert zero.is_hidden() == ("sensors" in missing)
            if len(missing) == 2:  # homing takes a minute, and the stages do it in the same way on every bench
                home(page)
            circle(page, station)
            page.locator("#ended").get_by_role("button", name="Result").click()
            page.get_by_role("button", name="Report", exact=True).click()
            report = page.frame_locator("#cover iframe")
            report.locator("h1").first.wait_for()
            assert "simulated" in report.locator("body").inner_text()
            page.get_by_role("button", name="live scene").click()
            open_tab(page, "calibrate")
            page.locator("#calibrate .card", has_text="Force sensors").wait_for()
            assert page.locator("#calibrate .card", has_text="Force sensors").is_disabled() == bool(missing)
            assert page.locator("#calibrate .card", has_text="Latency").is_disabled() == ("tracker" in missing)
