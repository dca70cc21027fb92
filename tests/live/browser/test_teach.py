"""Waypoints added at the tip, by mouse and by keyboard: checked before the start, saved under a name, and run."""

import json
import re

import pytest
from playwright.sync_api import Page, expect

from tests.harness.chromium import open_tab, press_until, press_until_asked, press_until_sent
from tests.harness.serving import Served

POINTS = [[0, 0, 0, 0], [4, 0, 0.004, 0], [8, 0, 0.004, 0.003]]


@pytest.fixture
def teach(page: Page, station: Served) -> Page:
    """Open the form of waypoints with an empty table."""
    page.evaluate("() => { sessionStorage.removeItem('places'); history.replaceState(null, '', '#run'); }")
    page.reload()
    page.locator("#state", has_text="READY").wait_for()
    open_tab(page, "start")
    page.locator(".card", has_text="Move smoothly through").click()
    page.get_by_role("button", name="Add waypoint here").wait_for()
    return page


def says(page: Page, text: str) -> None:
    page.locator(".teach [role=status]", has_text=text).wait_for()


def table(page: Page) -> list[list[float]]:
    """Return the values of the waypoint table [s, mm]."""
    cells = page.locator("tr.place").evaluate_all(
        "rows => rows.map(row => [...row.querySelectorAll('input')].map(one => Number(one.value)))"
    )
    return [list(map(float, row)) for row in cells]


def take(page: Page, points: list[list[float]]) -> None:
    """Load a CSV file of `points` [s, m] into the table."""
    choose(page, "time [s], x [m], y [m], z [m]\n" + "\n".join(", ".join(map(str, row)) for row in points))
    page.locator("tr.place").nth(len(points) - 1).wait_for()


def choose(page: Page, text: str) -> None:
    """Choose a CSV file with this text."""
    page.get_by_label("CSV file").set_input_files({"name": "a.csv", "mimeType": "text/csv", "buffer": text.encode()})


def go(station: Served, pose: dict[str, float]) -> None:
    """Move the robot by a request of another client, and release the operator's lease afterwards."""
    assert station.post("/api/goto", {"joints": pose}).status_code == 202
    station.wait_for(
        lambda s: s["state"] == "READY" and all(abs(s["joints"][name] - there) < 1e-4 for name, there in pose.items())
    )
    station.rest.delete("/api/operator")


def test_waypoints_are_added_at_the_tip_and_the_page_warns_away_from_the_start(teach: Page, station: Served) -> None:
    add = teach.get_by_role("button", name="Add waypoint here")
    press_until(teach, add.click, lambda: len(table(teach)) > 0)
    assert table(teach) == [[0.0, 0.0, 0.0, 0.0]]
    before = station.status()
    go(station, {"inner_translation": before["joints"]["inner_translation"] + 0.005})
    teach.get_by_text("A motion from here shifts the whole path").wait_for()
    press_until(teach, add.click, lambda: len(table(teach)) > 1)
    assert len(table(teach)) == 2
    after = station.status()
    time, *place = table(teach)[1]
    moved = [1e3 * (b - a) for a, b in zip(before["tip_true"], after["tip_true"], strict=True)]
    assert place == pytest.approx(moved, abs=1.5)  # tolerance: noise of the measured tip
    assert time == pytest.approx(sum(x * x for x in place) ** 0.5 / 5.0, abs=0.02)  # time for the distance at 5 mm/s
    says(teach, "✓ according to the model, the tip reaches all 2")

    def go_to_start() -> None:
        question = press_until_asked(teach, teach.get_by_role("button", name="Go to the start").click)
        question.get_by_role("button", name="Go").click()

    press_until_sent(teach, go_to_start, "/api/goto")
    start = before["joints"]["inner_translation"]
    station.wait_for(lambda status: abs(status["joints"]["inner_translation"] - start) < 1e-4)
    teach.get_by_text("A motion from here shifts the whole path").wait_for(state="hidden")


def test_waypoints_are_added_from_the_jog_tab(teach: Page) -> None:
    open_tab(teach, "jog")
    for number in (1, 2):
        said = teach.get_by_role("status").filter(has_text=f"waypoint {number} is added")
        press_until(teach, teach.get_by_role("button", name="Add the tip to the waypoints").click, said.is_visible)
    open_tab(teach, "start")
    teach.get_by_role("button", name="all motions").click()  # the list opens from any other place, too
    open_tab(teach, "jog")
    said.get_by_role("button", name="Open the list").click()
    teach.locator("table.places tbody tr").nth(1).wait_for()
    assert [row[1:] for row in table(teach)[:1]] == [[0.0, 0.0, 0.0]]
    assert len(table(teach)) == 2


def test_waypoint_table_is_edited_reordered_undone_and_started_by_mouse(teach: Page, station: Served) -> None:
    take(teach, POINTS)
    says(teach, "✓ according to the model, the tip reaches all 3, the last one at 8 s")
    assert teach.locator("svg.way circle").count() == 6  # three waypoints, drawn from the side and from above
    teach.get_by_label("waypoint 3 up").click()
    assert table(teach) == [[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 4.0, 3.0], [8.0, 0.0, 4.0, 0.0]]
    teach.get_by_label("delete waypoint 3").click()
    teach.get_by_role("button", name="Undo").click()
    teach.get_by_role("button", name="Undo").click()
    assert table(teach) == [[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 4.0, 0.0], [8.0, 0.0, 4.0, 3.0]]
    teach.get_by_label("speed between waypoints").fill("1")
    teach.get_by_role("button", name="Times from speed").click()
    assert [row[0] for row in table(teach)] == [0.0, 4.0, 7.0]
    says(teach, "✓ according to the model, the tip reaches all 3, the last one at 7 s")
    with teach.expect_request("**/api/start") as asked:
        press_until_sent(teach, teach.get_by_role("button", name="Start motion").click)
    sent = json.loads(asked.value.post_data or "")
    assert sent["trajectory"]["points"] == [[0, 0, 0, 0], [4, 0, 0.004, 0], [7, 0, 0.004, 0.003]]
    assert sent["duration"] == 10
    station.wait_for(lambda status: status["state"] == "RUNNING")
    station.post("/api/stop")


def test_waypoint_table_is_created_and_changed_by_keyboard_only(teach: Page) -> None:
    teach.get_by_role("button", name="Add a row").focus()
    teach.keyboard.press("Enter")  # the first cell of the new row has the focus
    for text in ("5", "0", "4", "0"):
        teach.keyboard.press("Control+A")
        teach.keyboard.type(text)
        teach.keyboard.press("Tab")
    assert table(teach) == [[5.0, 0.0, 4.0, 0.0]]
    says(teach, "✓ according to the model, the tip reaches it at 5 s")
    teach.get_by_role("button", name="Add a row").focus()
    teach.keyboard.press("Enter")
    for text in ("9", "0", "6", "0"):
        teach.keyboard.press("Control+A")
        teach.keyboard.type(text)
        teach.keyboard.press("Tab")
    expect(teach.get_by_label("waypoint 2 up")).to_be_focused()
    teach.keyboard.press("Enter")
    assert table(teach) == [[5.0, 0.0, 6.0, 0.0], [9.0, 0.0, 4.0, 0.0]]


def test_first_unreachable_waypoint_is_marked_with_the_reason(teach: Page) -> None:
    take(teach, [*POINTS, [30, 0, 0.12, 0]])
    says(teach, "✗ the tip does not reach waypoint 4")
    expect(teach.locator("tr.place.bad td").first).to_have_text("4")
    expect(teach.locator("tr.why")).to_contain_text("waypoints cannot be followed: at")
    expect(teach.locator("tr.why")).not_to_have_text(re.compile(r"\d m\b"))  # the message uses the page's unit mm
    teach.get_by_label("waypoint 4 time s").fill("3")
    teach.get_by_label("waypoint 4 time s").press("Tab")
    teach.locator("tr.why", has_text="must be later than the previous row's 8 s").wait_for()
    expect(teach.get_by_role("button", name="Start motion")).to_be_disabled()


def test_waypoint_csv_file_is_read_in_its_unit_and_saved_again(teach: Page) -> None:
    take(teach, POINTS)
    with teach.expect_download() as download:
        teach.get_by_role("button", name="Save as CSV").click()
    assert download.value.path().read_text() == "time [s], x [mm], y [mm], z [mm]\n0, 0, 0, 0\n4, 0, 4, 0\n8, 0, 4, 3\n"
    choose(teach, "5, 0, 10, 0\n10, 0, 0")
    says(teach, "line 2: 3 numbers; a line is time [s], x, y, z")
    assert len(table(teach)) == 3  # the table is unchanged


def test_error_of_a_file_stays_when_the_check_of_the_table_ends(teach: Page) -> None:
    asked = []
    teach.route("**/api/waypoints/check", lambda route: asked.append(route))  # the answer to the check waits
    try:
        take(teach, POINTS)
        while not asked:
            teach.wait_for_timeout(50)
        choose(teach, "5, 0, 10")
        says(teach, "line 1: 3 numbers; a line is time [s], x, y, z")
        with teach.expect_response("**/api/waypoints/check"):
            asked[0].continue_()
        teach.locator(".way polyline:not(.guess)").first.wait_for(state="attached")  # the checked path is drawn
        says(teach, "line 1: 3 numbers; a line is time [s], x, y, z")
    finally:
        teach.unroute("**/api/waypoints/check")  # the route that leaves out the scene stays


def test_saved_motion_is_replaced_only_after_confirmation_and_can_be_loaded(teach: Page, station: Served) -> None:
    take(teach, POINTS)
    says(teach, "✓ according to the model")
    name = teach.get_by_label("name to save it under")
    save = teach.get_by_role("button", name="Save", exact=True)
    name.fill("../up")
    save.click()
    name.and_(teach.locator(":invalid")).wait_for()
    name.fill("taught_here")
    save.click()
    teach.locator(".note.good", has_text="experiments/taught_here.toml").wait_for()
    teach.get_by_label("delete waypoint 3").click()
    says(teach, "✓ according to the model, the tip reaches all 2")
    save.click()
    teach.get_by_role("dialog").get_by_text("'taught_here' exists already").wait_for()
    teach.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    teach.get_by_label("saved motions").select_option("taught_here")
    teach.get_by_role("button", name="Load").click()
    teach.locator("tr.place").nth(2).wait_for()
    assert table(teach) == [[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 4.0, 0.0], [8.0, 0.0, 4.0, 3.0]]
    station.rest.post("/api/operator", json={"take_over": True})
    assert station.post("/api/start", {"experiment": "taught_here"}).status_code == 202
    station.wait_for(lambda status: status["state"] == "RUNNING" and status["run"]["title"].startswith("taught here: "))
    station.post("/api/stop")


def pause(count: int) -> str:
    """Return a file of waypoints at the start, one each second."""
    return "\n".join(f"{second}, 0, 0, 0" for second in range(1, count + 1))


def test_stop_does_not_wait_for_a_long_table_and_a_longer_one_is_refused(teach: Page) -> None:
    choose(teach, pause(60_000))
    says(teach, "60000 waypoints are too many; at most 10000 are possible. Remove some, or divide the motion")
    choose(teach, pause(60_000).ljust(2_000_000))
    says(teach, "The file has 2000000 bytes; at most 1100000 are possible, enough for 10000 waypoints.")
    assert len(table(teach)) == 0
    teach.locator("#tab-start").focus()
    choose(teach, pause(10_000))
    teach.keyboard.press("Shift+Space")
    expect(teach.locator("#state")).to_have_text("STOPPED")
    says(teach, "✓ according to the model, the tip reaches all 10000, the last one at 10000 s")


def test_long_table_is_shown_in_parts_and_takes_no_row_beyond_the_limit(teach: Page) -> None:
    def shows(first: int, last: int, bad: str = "") -> None:
        expect(teach.get_by_text(f"waypoints {first} to {last} of ")).to_be_visible()
        expect(teach.locator("tr.place")).to_have_count(last + 1 - first)
        expect(teach.locator("tr.place.bad td:first-child")).to_have_text([bad] if bad else [])

    choose(teach, pause(250) + "\n7, 0, 0, 0")
    shows(201, 251, bad="251")
    teach.locator("#tab-start").focus()  # while a cell has the focus, the shown part stays
    choose(teach, pause(150) + "\n190, 0, 120, 0")
    shows(101, 151, bad="151")
    expect(teach.locator("svg.way circle.bad")).to_have_count(2)  # in both views
    choose(teach, pause(10_000))
    shows(1, 100)
    for button, first in (("next", 101), ("previous", 1), ("previous", 9901)):
        teach.get_by_label(f"{button} 100 waypoints").click()
        shows(first, first + 99)
    teach.get_by_role("button", name="Add a row").click()
    says(teach, "10001 waypoints are too many")
    teach.get_by_label("delete waypoint 10000").click()
    shows(9901, 9999)
    teach.get_by_role("button", name="Add a row").click()
    shows(9901, 10_000)
    rows = "rows: Array.from({ length: 10001 }, (_, i) => [i + 1, 0, 0, 0]), origin: null"
    teach.evaluate(f"() => sessionStorage.setItem('places', JSON.stringify({{ {rows} }}))")
    teach.reload()
    says(teach, "No waypoint yet")
