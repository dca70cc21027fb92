"""Behaviour of a station whose data folder cannot be written: runs are refused or end, and everything else works.

The tests replace the folder by a file, because root can also write to a folder without write permission.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.harness.serving import Served, serving

HOLD = {"trajectory": {"kind": "hold"}, "duration": 4.0}


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with serving() as served:
        yield served


@contextmanager
def no_data(served: Served) -> Iterator[Path]:
    """Replace the station's data folder by a file during the block."""
    data = served.said.parent
    away = data.with_name(f"{data.name}-away")
    data.rename(away)
    data.write_text("in the way", encoding="utf-8")
    try:
        yield data
    finally:
        data.unlink()
        away.rename(data)


def goes_on(served: Served) -> None:
    """Check that the station completes a run and lists its recording."""
    begun = served.post("/api/start", HOLD)
    assert begun.status_code == 202, begun.text
    served.wait_for(lambda status: status["state"] == "READY" and not status["run"]["recording"])
    assert begun.json()["run_id"] in [run["id"] for run in served.rest.get("/api/runs").json()]


def test_start_is_refused_without_a_data_folder_and_other_requests_are_answered(served: Served):
    served.ready()
    with no_data(served) as data:
        refused = served.post("/api/start", HOLD)
        assert refused.status_code == 422, refused.text
        assert str(data) in refused.json()["error"]
        assert served.status()["state"] == "READY"
        assert served.post("/api/stop").json() == {"state": "STOPPED", "note": "", "confirmed": True}
        assert served.post("/api/reset").status_code == 200
        for path in ("/api/log", "/api/runs", "/api/calibration/results", "/api/experiments?check=false", "/api/rig"):
            assert served.rest.get(path).status_code == 200, path
        saved = served.rest.put("/api/experiments/mine", json={})
        assert saved.status_code < 500, saved.text
    served.wait_for(lambda status: status["state"] == "READY")
    goes_on(served)


def test_active_run_ends_after_the_loss_of_the_data_folder_and_the_next_run_is_recorded(served: Served):
    served.ready()
    assert served.post("/api/start", HOLD).status_code == 202
    served.wait_for(lambda status: status["phase"] == "moving")
    with no_data(served):
        ended = served.wait_for(lambda status: status["state"] != "RUNNING" and not status["run"]["recording"])
        assert ended["state"] in ("READY", "HOLD")
        assert served.post("/api/stop").json()["state"] == "STOPPED"
    served.ready()
    goes_on(served)
