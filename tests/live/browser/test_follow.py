"""A followed target on the page: distance of the tip, loss of the target, and the cause of the run's end."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page

from tests.harness.chromium import press_until_sent
from tests.harness.serving import Served, serving

#: JavaScript that returns whether the page reports the loss of the target while the run continues.
LOST_WHILE_RUNNING = """() => {
  const cell = document.querySelector("#strip div");
  return cell.textContent.includes("target not seen") && cell.querySelector("output").textContent === "\u2013"
    && document.querySelector("#state").textContent === "RUNNING";
}"""


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving("--lab", "breathing") as served:
        yield served


def test_value_strip_shows_the_distance_to_the_target_and_reports_a_lost_target(page: Page, station: Served) -> None:
    page.locator(".card", has_text="Follow: the tip keeps its offset").click()
    press_until_sent(page, page.get_by_role("button", name="Start experiment").click)
    page.locator("#strip div", has_text="true error off target").wait_for()
    page.wait_for_function("() => /^[0-9.]+ mm$/.test(document.querySelector('#strip output').textContent)")
    station.rest.post("/api/operator", json={"take_over": True})
    lost = station.post("/api/faults", {"faults": [{"kind": "lose_target", "device": "tracker"}]})
    assert lost.status_code == 200, lost.text
    page.wait_for_function(LOST_WHILE_RUNNING)  # the setpoint rests until the target has been lost for 2 s
    page.locator("#state", has_text="HOLD").wait_for()
    page.locator("#says", has_text="target was not measured for 2.0 s").wait_for()
    page.locator("#says", has_text="bring it back into the tracker's volume").wait_for()
