"""axe-core finds no violation of WCAG 2.1 A and AA in any tab, sub-tab, form, dialog or latched state of the page.

The frame of the scene is excluded: its contents are viser's page, which this project does not write.
"""

import re
from collections.abc import Callable
from typing import Any, Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

from tests.harness.chromium import open_tab, press_escape, press_until, press_until_asked
from tests.harness.serving import Served
from tests.harness.waiting import until

AXE = Axe()
OPTIONS = {
    "resultTypes": ["violations"],
    "iframes": False,
    "runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]},
}
TABS = ("start", "jog", "plots", "runs", "devices", "calibrate", "faults")
HOLD = {"trajectory": {"kind": "hold"}, "duration": 0.5}
SCHEMES: tuple[Literal["dark", "light"], ...] = ("dark", "light")
SIZES = [(1280, 720), (390, 844)]


def violations(page: Page) -> list[tuple[str, str, str]]:
    """Return rule, element and explanation of each violation on the visible page, in the light and the dark theme."""
    found: list[dict[str, Any]] = []
    for scheme in SCHEMES:
        page.emulate_media(color_scheme=scheme)
        found += AXE.run(page, {"exclude": [["#scene"]]}, OPTIONS).response["violations"]
    return [(each["id"], node["html"], node["failureSummary"]) for each in found for node in each["nodes"]]


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_axe_finds_no_violation_in_any_tab(page: Page, width: int, height: int) -> None:
    page.set_viewport_size({"width": width, "height": height})
    try:
        for name in TABS:
            open_tab(page, name)
            page.locator(f"#{name} > :not(.dim):visible").first.wait_for()
            assert violations(page) == [], name
    finally:
        page.set_viewport_size({"width": 1280, "height": 720})


def experiment(page: Page) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="Fig. 4").click()
    page.get_by_role("button", name="Start experiment").wait_for()


def free_motion(page: Page) -> None:
    open_tab(page, "start")
    page.locator(".card", has_text="Move the tip along a circle").click()
    page.get_by_role("button", name="Start motion").wait_for()


def procedure(page: Page) -> None:
    open_tab(page, "calibrate")
    page.locator("#calibrate .card").first.click()
    page.get_by_role("button", name="Start: ").wait_for()


def recorded_run(page: Page) -> None:
    open_tab(page, "runs")
    # The list is replaced when the newest run arrives, perhaps during the press.
    press_until(page, page.locator("#runs .card").first.click, page.locator(".result").is_visible)


def queue_runs(station: Served) -> bool:
    """Return whether a run of the queue is running; resume a queue that has paused, as it may on a busy computer."""
    queue = station.rest.get("/api/queue").json()
    if queue["paused"]:
        station.post("/api/queue/resume")
    return any(entry["state"] == "running" for entry in queue["entries"])


def test_axe_finds_no_violation_in_welcome_tour_palette_help_queue_and_run(first_visit: Page, station: Served) -> None:
    page = first_visit
    page.locator("#state", has_text="READY").wait_for()
    assert violations(page) == []
    page.get_by_role("button", name="Show me around").click()
    assert violations(page) == []
    page.get_by_role("button", name="Skip").click()
    page.keyboard.press("Control+k")
    page.get_by_role("option", name="Case fig8").first.wait_for()
    assert violations(page) == []
    press_escape(page)
    page.get_by_role("button", name="help").click()
    assert violations(page) == []
    page.get_by_role("button", name="Close", exact=True).click()
    runs = {"trajectory": {"kind": "hold"}, "duration": 600.0, "repeat": 3}
    assert station.post("/api/queue", runs).status_code == 200
    until(lambda: queue_runs(station))
    page.locator("#queue li.running").wait_for()
    page.locator("#now").wait_for()
    assert violations(page) == []
    station.post("/api/stop")
    page.locator("#queue", has_text="paused").wait_for()
    station.ready()
    page.locator("#state", has_text="READY").wait_for()
    assert violations(page) == []


@pytest.mark.parametrize("open_view", [experiment, free_motion, procedure, recorded_run])
def test_axe_finds_no_violation_in_a_form_or_a_result(
    station: Served, page: Page, open_view: Callable[[Page], None]
) -> None:
    station.post("/api/start", HOLD)
    station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])
    open_view(page)
    try:
        assert violations(page) == []
    finally:
        page.get_by_role("button", name=re.compile("all (motions|procedures|runs)")).first.click()


def test_axe_finds_no_violation_in_a_dialog_or_a_latched_state(station: Served, page: Page) -> None:
    station.rest.delete("/api/operator")
    for name, button in (("start", "Take control"), ("devices", "Home…")):
        open_tab(page, name)
        press_until_asked(page, page.get_by_role("button", name=button).last.click)
        assert violations(page) == [], button
        press_escape(page)
    station.post("/api/stop")
    page.locator("#latched", has_text="What does this mean?").wait_for()
    assert violations(page) == []
