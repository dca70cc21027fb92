"""The queue of runs and the run in progress, at the top of the tab Run."""

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.harness.chromium import open_tab, press_until_asked, press_until_sent
from tests.harness.serving import Served
from tests.harness.waiting import until

CIRCLE = {
    "trajectory": {"kind": "circle", "radius": 0.002, "period": 7.0},
    "load": {"kind": "constant", "magnitude": 0.1},
    "duration": 600.0,
}


@pytest.fixture(autouse=True)
def empty_queue(station: Served) -> Iterator[None]:
    station.rest.delete("/api/queue")
    station.rest.delete("/api/operator")
    yield
    station.ready()
    station.rest.delete("/api/queue")


def entries(station: Served) -> list[dict[str, Any]]:
    return station.rest.get("/api/queue").json()["entries"]


def rows(page: Page) -> Locator:
    return page.locator("#queue li")


def overview(page: Page) -> None:
    open_tab(page, "start")
    if page.get_by_role("button", name="all motions").count():
        page.get_by_role("button", name="all motions").click()
    page.locator(".card").first.wait_for()


def test_all_cases_of_an_experiment_are_queued_by_one_press_and_reordered_paused_and_removed(
    page: Page, station: Served
) -> None:
    overview(page)
    page.locator(".card", has_text="Fig. 8").click()
    page.get_by_role("button", name="Add all 6 cases to queue").click()
    page.get_by_role("dialog", name="Start the queue?").get_by_role("button", name="Start").click()
    page.locator("#queue li.running").wait_for()
    queue = entries(station)
    titles = [entry["title"] for entry in queue]
    assert len(titles) == 6
    move = f"/api/queue/{queue[3]['id']}/move"
    press_until_sent(page, page.get_by_role("button", name=f"{titles[3]}: earlier").click, move)
    until(lambda: [entry["title"] for entry in entries(station)][2] == titles[3])
    remove = page.get_by_role("button", name=f"{titles[5]}: remove")
    press_until_sent(page, remove.click, f"/api/queue/{queue[5]['id']}", "DELETE")
    until(lambda: len(entries(station)) == 5)
    press_until_sent(page, page.get_by_role("button", name="pause the queue").click, "/api/queue/pause")
    page.locator("#queue", has_text="paused by the operator").wait_for()
    station.wait_for(lambda s: s["phase"] == "moving")
    page.locator("#stop").click()
    page.locator("#queue li.failed").wait_for()
    press_until_sent(page, page.locator("#reset").click, "/api/reset")
    page.locator("#state", has_text="READY").wait_for()
    press_until_sent(page, page.get_by_role("button", name="continue the queue").click, "/api/queue/resume")
    running = station.wait_for(lambda s: s["state"] == "RUNNING")["run"]["title"]
    assert running == titles[1]
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
    clear = page.get_by_role("button", name="remove waiting runs from the queue")
    press_until_asked(page, clear.click)
    assert entries(station) != []  # until the user confirms
    page.get_by_role("dialog").get_by_role("button", name="Remove", exact=True).click()
    until(lambda: entries(station) == [])
    page.locator("#queue").wait_for(state="hidden")


def test_motion_is_added_to_the_queue_as_often_as_the_form_says(page: Page, station: Served) -> None:
    overview(page)
    page.locator(".card", has_text="Keep the tip where it is").click()
    repeat = page.get_by_label("repetitions in the queue")
    repeat.fill("51")
    page.get_by_role("button", name="Add to queue").click()
    repeat.and_(page.locator(":invalid")).wait_for()
    assert entries(station) == []
    repeat.fill("3")
    page.get_by_role("button", name="Add to queue").click()
    page.get_by_role("dialog", name="Start the queue?").get_by_role("button", name="Cancel").click()
    assert entries(station) == []
    page.get_by_role("button", name="Add to queue").click()
    page.get_by_role("dialog", name="Start the queue?").get_by_role("button", name="Start").click()
    page.locator("#notes", has_text="added to the queue 3 times").wait_for()
    expect(rows(page)).to_have_count(3)
    assert len({entry["title"] for entry in entries(station)}) == 1
    page.locator("#stop").click()
    page.locator("#state", has_text="STOPPED").wait_for()
    overview(page)


def test_tab_run_shows_the_run_in_progress_and_the_page_runs_it_again(page: Page, station: Served) -> None:
    overview(page)
    station.post("/api/start", CIRCLE)
    station.rest.delete("/api/operator")
    now = page.locator("#now")
    now.get_by_text("load: constant: along x, magnitude 0.1 N").wait_for()
    page.locator("#run-left", has_text="left of 10:00").wait_for()
    for quantity in ("Error", "Force"):
        chart = now.locator(".chart", has_text=quantity)
        page.wait_for_function(
            "chart => Number(chart.querySelector('output').textContent) > 0", arg=chart.element_handle()
        )
    now.get_by_label("text of the mark").fill("touched the tip")
    press_until_sent(page, now.get_by_role("button", name="Mark this moment").click, "/api/mark")
    page.locator("#notes", has_text="marked in the recording").wait_for()
    page.locator("#stop").click()
    station.wait_for(lambda s: s["state"] == "STOPPED")
    now.wait_for(state="hidden")
    press_until_sent(page, page.locator("#reset").click, "/api/reset")
    first = station.wait_for(lambda s: s["state"] == "READY" and not s["run"]["recording"])["run"]
    press_until_sent(page, page.locator("#ended").get_by_role("button", name="Run again").click)
    second = station.wait_for(lambda s: s["state"] == "RUNNING")["run"]
    assert second["id"] != first["id"]
    assert second["title"] == first["title"]
    page.locator("#stop").click()
    station.wait_for(lambda s: s["state"] == "STOPPED" and not s["run"]["recording"])
    settings = [station.rest.get(f"/api/runs/{run['id']}/settings").json() for run in (first, second)]
    assert settings[0] == settings[1]
    assert settings[0]["settings"]["load"]["magnitude"] == 0.1
    overview(page)
