"""A followed target on the page: distance of the tip, loss of the target, and the cause of the run's end."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page

from tests.harness.serving import Served, serving


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving("--lab", "breathing") as served:
        yield served


def test_value_strip_shows_the_distance_to_the_target_and_reports_a_lost_target(page: Page, station: Served) -> None:
    distance = page.locator("#strip div").first
    page.locator(".card", has_text="Follow: the tip keeps its offset").click()
    page.get_by_role("button", name="Start experiment").click()
    page.locator("#strip div", has_text="off target, true").wait_for()
    page.wait_for_function("() => /^[0-9.]+ mm$/.test(document.querySelector('#strip output').textContent)")
    station.rest.post("/api/operator", json={"take_over": True})
    lost = station.post("/api/faults", {"faults": [{"kind": "lose_target", "device": "tracker"}]})
    assert lost.status_code == 200, lost.text
    page.wait_for_function("() => document.querySelector('#strip output').textContent === '\\u2013'")
    assert "target not seen" in distance.inner_text()
    assert station.status()["state"] == "RUNNING"  # the setpoint rests until the target has been lost for 2 s
    page.locator("#state", has_text="HOLD").wait_for()
    assert "target was not measured for 2.0 s" in page.locator("#says").inner_text()
    assert "bring it back into the tracker's volume" in page.locator("#says").inner_text()
