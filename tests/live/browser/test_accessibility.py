"""axe-core finds no violation of WCAG 2.1 A and AA in any tab, sub-tab, form, dialog or latched state of the page.

The frame of the scene is excluded: its contents are viser's page, which this project does not write.
"""

import re
from collections.abc import Callable
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

from tests.harness.chromium import open_tab
from tests.harness.serving import Served

AXE = Axe()
OPTIONS = {
    "resultTypes": ["violations"],
    "iframes": False,
    "runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]},
}
TABS = ("start", "jog", "plots", "runs", "devices", "calibrate", "faults")
HOLD = {"trajectory": {"kind": "hold"}, "duration": 0.5}
SIZES = [(1280, 720), (390, 844), (720, 450)]


def violations(page: Page) -> list[tuple[str, str, str]]:
    """Return rule, element and explanation of each violation on the visible page."""
    found: list[dict[str, Any]] = AXE.run(page, {"exclude": [["#scene"]]}, OPTIONS).response["violations"]
    return [(each["id"], node["html"], node["failureSummary"]) for each in found for node in each["nodes"]]


@pytest.fixture(params=["light", "dark"])
def themed(request: pytest.FixtureRequest, page: Page) -> Page:
    page.emulate_media(color_scheme=request.param)
    return page


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_axe_finds_no_violation_in_any_tab(themed: Page, width: int, height: int) -> None:
    themed.set_viewport_size({"width": width, "height": height})
    try:
        for name in TABS:
            open_tab(themed, name)
            themed.locator(f"#{name} > :not(.dim)").first.wait_for()
            assert violations(themed) == [], name
    finally:
        themed.set_viewport_size({"width": 1280, "height": 720})


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
    page.locator("#runs .card").first.click()
    page.locator(".result").wait_for()


@pytest.mark.parametrize("open_view", [experiment, free_motion, procedure, recorded_run])
def test_axe_finds_no_violation_in_a_form_or_a_result(
    station: Served, themed: Page, open_view: Callable[[Page], None]
) -> None:
    station.post("/api/start", HOLD)
    station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])
    open_view(themed)
    try:
        assert violations(themed) == []
    finally:
        themed.get_by_role("button", name=re.compile("all (motions|procedures|runs)")).first.click()


def test_axe_finds_no_violation_in_a_dialog_or_a_latched_state(station: Served, themed: Page) -> None:
    station.rest.delete("/api/operator")
    for name, button in (("start", "Take control"), ("devices", "Home…")):
        open_tab(themed, name)
        themed.get_by_role("button", name=button).last.click()
        themed.get_by_role("dialog").wait_for()
        assert violations(themed) == [], button
        themed.keyboard.press("Escape")
    station.post("/api/stop")
    themed.locator("#latched", has_text="What does this mean?").wait_for()
    assert violations(themed) == []
