"""The queue of runs on a live station: order, the first HOLD, STOP, and what an operator can change."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.harness.serving import Served
from tests.harness.waiting import until

SHORT = {"trajectory": {"kind": "hold"}, "duration": 0.5}
LONG = {"trajectory": {"kind": "hold"}, "duration": 600.0}


@pytest.fixture(autouse=True)
def empty_queue(station: Served) -> None:
    station.rest.delete("/api/queue")


def queue(station: Served) -> dict[str, Any]:
    return station.rest.get("/api/queue").json()


def reached(station: Served, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Wait until the queue fulfils the condition, and return it."""
    until(lambda: condition(queue(station)))
    return queue(station)


def move_while_another_run_waits(station: Served) -> None:
    """Queue a long and a short run, and wait until the robot moves in the long one."""
    station.post("/api/queue", LONG)
    station.post("/api/queue", SHORT)
    reached(station, lambda now: now["entries"][0]["state"] == "running")
    station.wait_for(lambda s: s["phase"] == "moving")


def test_queue_runs_its_entries_one_after_the_other(station: Served) -> None:
    answer = station.post("/api/queue", SHORT | {"repeat": 3})
    assert answer.status_code == 200, answer.text
    done = reached(station, lambda now: [one["state"] for one in now["entries"]] == ["done"] * 3)
    runs = [one["run"] for one in done["entries"]]
    assert len(set(runs)) == 3
    listed = [run["id"] for run in station.rest.get("/api/runs").json()]
    assert [run for run in reversed(listed) if run in runs] == runs
    assert reached(station, lambda now: now["paused"] != "")["paused"] == "all runs are done"


def test_stop_pauses_the_queue_and_nothing_moves_after_the_reset_until_it_is_resumed(station: Served) -> None:
    move_while_another_run_waits(station)
    station.post("/api/stop")
    paused = reached(station, lambda now: now["paused"] != "" and now["entries"][0]["state"] != "running")
    assert [one["state"] for one in paused["entries"]] == ["failed", "waiting"]
    # The queue is paused by the STOP or by the end of the run, whichever it notices first.
    assert "stopped by" in paused["paused"]
    station.ready()
    moved: list[str] = []
    station.wait_for(lambda s: moved.append(s["state"]) or len(moved) > 40)
    assert set(moved) == {"READY"}
    assert station.post("/api/queue/resume", {}).status_code == 200
    reached(station, lambda now: now["entries"][1]["state"] == "done")


def test_entries_can_be_moved_and_removed_while_they_wait(station: Served) -> None:
    station.post("/api/queue", LONG)
    reached(station, lambda now: now["entries"][0]["state"] == "running")
    for duration in (1.0, 2.0):
        station.post("/api/queue", SHORT | {"duration": duration})
    running, first, second = (one["id"] for one in queue(station)["entries"])
    station.post(f"/api/queue/{second}/move", {"by": -1})
    assert [one["id"] for one in queue(station)["entries"]] == [running, second, first]
    assert station.rest.delete(f"/api/queue/{first}").status_code == 200
    refused = station.rest.delete(f"/api/queue/{running}")
    assert refused.status_code == 409
    assert "press STOP" in refused.json()["error"]
    assert station.post("/api/queue/999/move", {"by": 1}).status_code == 409
    station.post("/api/stop")


def test_all_cases_of_an_experiment_are_queued_by_one_request(station: Served) -> None:
    station.post("/api/queue", LONG)
    listed = {one["name"]: one for one in station.rest.get("/api/experiments?check=false").json()}
    answer = station.post("/api/queue", {"experiment": "fig8"})
    assert answer.status_code == 200, answer.text
    assert len(answer.json()["entries"]) == 1 + len(listed["fig8"]["cases"])
    station.post("/api/stop")
    assert station.post("/api/queue", {"experiment": "fig8", "case": "none"}).status_code == 422


def test_clearing_the_queue_removes_a_stopped_run_whose_recording_is_not_complete(station: Served) -> None:
    move_while_another_run_waits(station)
    station.post("/api/stop")
    station.wait_for(lambda s: s["state"] == "STOPPED")
    assert station.rest.delete("/api/queue").json()["entries"] == []
    assert reached(station, lambda now: now["paused"] != "")["entries"] == []


def test_queue_is_bounded(station: Served) -> None:
    station.post("/api/queue", LONG)
    for _ in range(3):
        assert station.post("/api/queue", SHORT | {"repeat": 50}).status_code == 200
    refused = station.post("/api/queue", SHORT | {"repeat": 50})
    assert refused.status_code == 409
    assert "at most 200" in refused.json()["error"]
    station.post("/api/stop")


def test_queued_run_that_is_stopped_and_reset_at_once_is_failed(station: Served) -> None:
    for _ in range(2):
        move_while_another_run_waits(station)
        station.post("/api/stop")
        assert station.post("/api/reset").status_code == 200
        ended = reached(station, lambda now: now["entries"][0]["state"] != "running")
        assert [one["state"] for one in ended["entries"]] == ["failed", "waiting"]
        assert ended["entries"][0]["reason"].startswith("stopped by")
        assert ended["paused"] != ""
        station.rest.delete("/api/queue")
        station.ready()
