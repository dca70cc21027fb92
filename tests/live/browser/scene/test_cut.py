"""The scene's websocket is dropped while all other connections stay."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.harness.chromium import chromium, scene_page, wait_until_current
from tests.harness.relay import Relay, of_scene, relayed
from tests.harness.serving import Served
from tests.harness.waiting import until

HOLD = {"trajectory": {"kind": "hold"}, "duration": 60.0}


@pytest.fixture
def wire(station: Served) -> Iterator[Relay]:
    with relayed(station.port, of_scene) as relay:
        yield relay


@pytest.fixture
def cut_page(station: Served, wire: Relay) -> Iterator[Page]:
    """The page in a browser that reaches the station through the relay."""
    rule = f"--host-resolver-rules=MAP localhost:{station.port} 127.0.0.1:{wire.port}"
    with chromium(rule) as browser:
        page = scene_page(browser)
        page.goto(f"http://localhost:{station.port}/")
        page.frame_locator("#scene").locator("canvas").first.wait_for()
        yield page


def test_disconnected_scene_is_reported_and_reconnects_while_stop_keeps_working(
    cut_page: Page, station: Served, wire: Relay
) -> None:
    page, notice = cut_page, cut_page.locator("#scene-cut")
    page.locator("#state", has_text="READY").wait_for()
    scenes = wire.passed
    expect(notice).to_be_hidden()
    station.post("/api/start", HOLD)
    page.locator("#state", has_text="RUNNING").wait_for()
    wire.cut()
    notice.wait_for()
    notice.filter(has_text="STOP").wait_for()
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
    wait_until_current(page)  # only the scene is cut
    wire.mend()
    until(lambda: wire.passed > scenes)  # the notice is also hidden while the page's data are stale
    notice.wait_for(state="hidden")
    page.frame_locator("#scene").locator("canvas").first.wait_for()
