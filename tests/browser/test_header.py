"""The header without the scene: it must tell the truth and stop the robot whatever else fails."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page

from tests.serving import Served, serving

HOLD = {"trajectory": {"kind": "hold"}, "duration": 60.0}


@pytest.fixture(scope="module")
def running() -> None:
    """Each of these tests ends its own station."""


@contextmanager
def header(browser: Browser, station: Served) -> Iterator[Page]:
    page = browser.new_page()
    page.route("**/viser/**", lambda route: route.abort())
    page.goto(station.url)
    page.locator("#state", has_text="READY").wait_for(timeout=20_000)
    try:
        yield page
    finally:
        page.close()


def test_stop_works_with_a_broken_scene(browser: Browser) -> None:
    with serving() as station, header(browser, station) as page:
        station.post("/api/start", HOLD)
        page.locator("#state", has_text="RUNNING").wait_for(timeout=3000)
        page.locator("#stop").click()
        page.locator("#state", has_text="STOPPED").wait_for(timeout=3000)
        assert station.status()["state"] == "STOPPED"


def test_a_dead_control_process_shows_as_fault_at_once_and_a_reset_revives_it(browser: Browser) -> None:
    with serving() as station, header(browser, station) as page:
        page.evaluate(
            """() => {
              window.faultSeen = null;
              const state = document.getElementById('state');
              const look = () => { if (state.textContent === 'FAULT') window.faultSeen ??= Date.now(); };
              new MutationObserver(look).observe(state, {childList: true, characterData: true, subtree: true});
            }"""
        )
        killed = 1e3 * time.time()
        station.control_process().kill()
        page.locator("#state", has_text="FAULT").wait_for(timeout=3000)
        assert page.evaluate("() => window.faultSeen") - killed < 500
        assert "signal 9" in page.locator("#cause").inner_text()
        page.locator("#reset").click()
        page.locator("#state", has_text="READY").wait_for(timeout=20_000)
        assert station.post("/api/start", HOLD).status_code == 202
        page.locator("#state", has_text="RUNNING").wait_for(timeout=3000)


def test_a_station_that_is_gone_shows_as_such(browser: Browser) -> None:
    with serving() as station, header(browser, station) as page:
        station.end()
        page.locator("#state", has_text="NO ANSWER").wait_for(timeout=3000)
        assert "emergency stop" in page.locator("#cause").inner_text()
        assert "stale" in str(page.locator("body").get_attribute("class"))
