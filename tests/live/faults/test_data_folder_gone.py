"""Behaviour of a station whose data folder cannot be written: runs are refused or end, and everything else works.

The tests replace the folder by a file, because root can also write to a folder without write permission. The
two change places in one step: while neither is there, the station creates the folder again for its audit log.
"""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.harness.serving import Served

HOLD = {"trajectory": {"kind": "hold"}, "duration": 4.0}


@contextmanager
def no_data(station: Served) -> Iterator[Path]:
    """Replace the station's data folder by a file during the block."""
    data = station.said.parent
    away = data.with_name(f"{data.name}-away")
    away.write_text("in the way", encoding="utf-8")
    exchange(data, away)
    try:
        yield data
    finally:
        exchange(data, away)
        away.unlink()


def exchange(one: Path, other: Path) -> None:
    """Exchange the names of a file and a folder in one step, by Linux's `renameat2`."""
    here, exchanged = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(here, os.fsencode(one), here, os.fsencode(other), exchanged) != 0:
        raise OSError(ctypes.get_errno(), "the names of the data folder and the file were not exchanged", str(one))


def goes_on(station: Served) -> None:
    """Check that the station completes a run and lists its recording."""
    begun = station.post("/api/start", HOLD)
    assert begun.status_code == 202, begun.text
    station.wait_for(lambda status: status["state"] == "READY" and not status["run"]["recording"])
    assert begun.json()["run_id"] in [run["id"] for run in station.rest.get("/api/runs").json()]


def test_start_is_refused_without_a_data_folder_and_other_requests_are_answered(station: Served):
    with no_data(station) as data:
        refused = station.post("/api/start", HOLD)
        assert refused.status_code == 422, refused.text
        assert str(data) in refused.json()["error"]
        assert station.status()["state"] == "READY"
        assert station.post("/api/stop").json() == {"state": "STOPPED", "note": "", "confirmed": True}
        assert station.post("/api/reset").status_code == 200
        for path in ("/api/log", "/api/runs", "/api/calibration/results", "/api/experiments?check=false", "/api/rig"):
            assert station.rest.get(path).status_code == 200, path
        saved = station.rest.put("/api/experiments/mine", json={})
        assert saved.status_code < 500, saved.text
    station.wait_for(lambda status: status["state"] == "READY")
    goes_on(station)


def test_active_run_ends_after_the_loss_of_the_data_folder_and_the_next_run_is_recorded(station: Served):
    assert station.post("/api/start", HOLD).status_code == 202
    station.wait_for(lambda status: status["phase"] == "moving")
    with no_data(station):
        ended = station.wait_for(lambda status: status["state"] != "RUNNING" and not status["run"]["recording"])
        assert ended["state"] in ("READY", "HOLD")
        assert station.post("/api/stop").json()["state"] == "STOPPED"
    station.ready()
    goes_on(station)
