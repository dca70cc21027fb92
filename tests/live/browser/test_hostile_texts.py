"""Script injection: texts of users are shown literally and never run as scripts."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from station.cli.main import main
from tests.harness.chromium import bare_page, open_tab
from tests.harness.serving import Served, serving

#: Ends a title, a script, an attribute and a line of a script; includes line separator and right-to-left characters.
HOSTILE = (
    "</title></script><script>top.ran = 1</script><img src=nowhere class=hostile onerror='top.ran = 2'>"
    "\"'`${top.ran = 3}\u2028\u202e{{DATA}} <!--"
)
#: A title is one line, so it has no line separator.
TITLE = HOSTILE.replace("\u2028", "")
RUN = f"""
title = {json.dumps(TITLE)}
start = {{ outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }}
duration = 0.5
settling = 0.0
[trajectory]
kind = "circle"
radius = 0.006
period = 8.0
"""
FOUND = {
    "procedure": "axes", "made": HOSTILE, "lab": HOSTILE, "simulated": False, "findings": [HOSTILE], "visits": 1,
    "found": [dict.fromkeys(("name", "before", "found", "interval"), HOSTILE)], "robot_s": 1.0,
}  # fmt: skip
#: Name of a folder: no slash, and not longer than the file system allows.
NAME = HOSTILE.replace("/", "")[:80]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, a calibration and a folder with this name."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "own.toml").write_text(RUN, encoding="utf-8")
    assert main(("run", str(folder / "own.toml"), "--jobs", "1", "--data", str(folder), "--json")) == 0
    (recorded,) = folder.glob("own*/")
    recorded.rename(folder / NAME)
    (folder / "calibrations" / NAME).mkdir(parents=True)
    (folder / "calibrations" / NAME / "report.json").write_text(json.dumps(FOUND), encoding="utf-8")
    # Files that the page offers as experiments: one with a hostile title and case, and one with a hostile key.
    (folder / "experiments").mkdir()
    (folder / "experiments" / f"{NAME}.toml").write_text(RUN, encoding="utf-8")
    (folder / "experiments" / "broken.toml").write_text(f"{json.dumps(HOSTILE)} = 1\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def hostile(data: Path) -> Iterator[Served]:
    with serving("--data", str(data)) as served:
        served.ready()
        yield served


@pytest.fixture
def page(hostile: Served, browser: Browser) -> Iterator[Page]:
    """The page; errors and dialogs caused by an injected text fail the test at the end."""
    with bare_page(browser, hostile) as page:
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(dialog.message))
        yield page
        assert complaints == []


def untouched(page: Page) -> None:
    assert page.evaluate("window.ran") is None
    for frame in page.frames:
        expect(frame.locator(".hostile")).to_have_count(0)


def test_hostile_text_in_a_run_its_notes_report_and_replay_is_not_executed(hostile: Served, page: Page) -> None:
    (run,) = hostile.rest.get("/api/runs").json()
    assert run["id"] == NAME
    open_tab(page, "runs")
    page.locator(".card.run").click()
    page.locator("#runs textarea").fill(HOSTILE)
    page.get_by_role("button", name="Save").click()
    page.locator("#runs", has_text="All numbers").wait_for()
    page.locator("#runs summary", has_text="All numbers").click()
    for what in ("Report", "Replay"):
        page.get_by_role("button", name=what, exact=True).click()
        page.locator("#cover", has_text="this is not live").wait_for()
        inside = page.frame_locator("#cover iframe")
        expect(inside.locator("h1")).to_contain_text("top.ran = 1")
        untouched(page)
        page.get_by_role("button", name="live scene").click()
    page.get_by_role("button", name="all runs").click()
    page.locator(".card.run", has_text="top.ran = 2").wait_for()
    untouched(page)


def test_hostile_text_in_a_calibration_is_not_executed(page: Page) -> None:
    open_tab(page, "calibrate")
    page.locator("#calibrate .card", has_text="top.ran = 1").click()
    page.locator("#found", has_text="top.ran = 1").wait_for()
    untouched(page)


def test_hostile_text_in_operator_name_and_log_is_not_executed(hostile: Served, page: Page) -> None:
    name = "<img src=x class=hostile onerror=top.x()>"[:40]
    assert hostile.rest.post("/api/operator", json={"name": name, "take_over": True}).json()["name"] == name
    assert hostile.rest.post("/api/start", json={"experiment": HOSTILE}).status_code == 422
    page.locator("#operator", has_text=name).wait_for()
    open_tab(page, "faults")
    page.locator("#faults", has_text="top.ran = 1").wait_for()
    untouched(page)
    hostile.rest.delete("/api/operator")


def test_hostile_text_in_experiments_their_errors_and_the_queue_is_not_executed(hostile: Served, page: Page) -> None:
    open_tab(page, "start")
    page.locator("#start", has_text="top.ran = 1").first.wait_for()
    untouched(page)
    assert hostile.post("/api/queue", {"experiment": NAME}).status_code == 200
    page.locator("#queue", has_text="top.ran = 1").wait_for()
    untouched(page)
    hostile.post("/api/stop")
    page.locator("#state", has_text="STOPPED").wait_for()
    untouched(page)
    hostile.ready()
    hostile.rest.delete("/api/queue")
    hostile.rest.delete("/api/operator")
