"""Nothing below the header moves by itself: not when a run starts or ends, at a HOLD, or when a message appears."""

from typing import Any

from playwright.sync_api import Page

from tests.harness.chromium import wait_until_current
from tests.harness.serving import Served

#: Compare the places of all visible elements five times a second; `moved` has each that moved by more than 1 px.
WATCH = """() => {
    const seen = new Map();
    window.moved = [];
    setInterval(() => {
        for (const one of document.querySelectorAll("main *")) {
            if (one.closest("svg, #view, dialog") || !one.checkVisibility()) continue;
            const { left, top, width, height } = one.getBoundingClientRect(), was = seen.get(one);
            if (width === 0 || height === 0) continue;
            seen.set(one, [left, top]);
            if (was === undefined || Math.max(Math.abs(left - was[0]), Math.abs(top - was[1])) <= 1) continue;
            const near = one.closest("[id]").id, state = document.querySelector("#state").textContent;
            window.moved.push([state, near, one.outerHTML.slice(0, 80), was, [left, top]]);
        }
    }, 200);
}"""
STAY = {"trajectory": {"kind": "hold"}, "load": {"kind": "constant", "magnitude": 0.1}}


def _moved(page: Page) -> list[Any]:
    page.wait_for_timeout(1000)  # several comparisons after the last change
    return page.evaluate("() => window.moved")


def test_no_element_moves_through_a_run_a_stop_a_hold_and_a_message(page: Page, station: Served) -> None:
    page.goto(f"{station.url}/#run/motion/circle")
    page.locator("#start form").wait_for()
    wait_until_current(page)
    page.evaluate(WATCH)
    assert station.post("/api/start", {**STAY, "duration": 3.0}).status_code == 202
    page.locator("#now progress").wait_for()
    page.locator("#ended", has_text="complete").get_by_role("button", name="Result").wait_for()
    assert _moved(page) == []
    assert station.post("/api/start", {**STAY, "duration": 600.0}).status_code == 202
    page.locator("#now progress").wait_for()
    station.post("/api/stop")
    page.locator("#latched").wait_for()
    page.locator("#ended", has_text="stopped by").wait_for()
    assert _moved(page) == []
    station.post("/api/reset")
    page.locator("#latched").wait_for(state="hidden")
    station.post("/api/faults", {"faults": [{"kind": "lose_tool", "device": "tracker"}]})
    page.locator("#state", has_text="HOLD").wait_for()
    assert _moved(page) == []
    station.rest.delete("/api/faults")
    station.post("/api/reset")
    page.locator("#state", has_text="READY").wait_for()
    page.evaluate("() => import('/static/page/station.js').then((all) => all.note('a message'))")
    page.locator(".note", has_text="a message").wait_for()
    assert _moved(page) == []
