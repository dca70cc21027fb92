"""Somebody sets the computer's clock, back and forth, in the middle of a run: nothing of the station goes by it.

`libfaketime` tells the station's processes another time of day, and leaves the clock that only counts alone.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from station.recording.read import read_case
from tests.harness.serving import Served, serving

LIBRARY = next(iter(sorted(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"))), None)
pytestmark = pytest.mark.skipif(LIBRARY is None, reason="needs libfaketime (apt install faketime)")
JUMPS = ("-3600", "+86400", "-40000000", "+0")


@pytest.fixture
def offset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with how far the clock of what is started from here on is off [s]."""
    file = tmp_path / "offset"
    file.write_text("+0\n", encoding="utf-8")
    monkeypatch.setenv("LD_PRELOAD", str(LIBRARY))
    monkeypatch.setenv("FAKETIME_TIMESTAMP_FILE", str(file))
    for name in ("FAKETIME_NO_CACHE", "FAKETIME_DONT_FAKE_MONOTONIC", "NO_FAKE_STAT"):
        monkeypatch.setenv(name, "1")
    return file


@pytest.fixture
def served(offset: Path) -> Iterator[Served]:
    with serving() as served:
        yield served


def test_a_run_goes_on_is_recorded_whole_and_keeps_its_operator(served: Served, offset: Path):
    served.ready()
    circle = {"kind": "circle", "radius": 0.003, "period": 10.0}
    run = served.post("/api/start", {"trajectory": circle, "duration": 10.0}).json()["run_id"]
    served.wait_for(lambda status: status["phase"] == "moving")
    for jump in JUMPS:
        offset.write_text(f"{jump}\n", encoding="utf-8")
        ticks = served.status()["loop"]["ticks"]
        status = served.wait_for(lambda status, ticks=ticks: status["loop"]["ticks"] > ticks + 500)
        assert (status["state"], status["stale"]) == ("RUNNING", False), (jump, status["cause"])
        assert status["operator"]["you"]
        assert 5.0 < status["operator"]["lapses_s"] <= 10.0
    status = served.wait_for(lambda status: status["state"] != "RUNNING" and not status["run"]["recording"])
    assert status["state"] == "READY", status["cause"]

    case = read_case(served.said.parent / run / "run.mcap")
    time = case.of("time")[:, 0]
    assert np.all(np.diff(time) > 0.0)
    assert time[-1] == pytest.approx(10.0, abs=0.05)


def test_what_was_done_last_stands_first_in_the_log_after_the_clock_was_set_back(served: Served, offset: Path):
    served.ready()
    stranger = served.rest.post("/api/start", json={}, headers={"host": "elsewhere"})  # a refusal of now
    assert stranger.status_code >= 400
    offset.write_text("-3600\n", encoding="utf-8")
    served.wait_for(lambda status: not status["stale"])
    assert served.post("/api/stop").status_code == 200
    told = [json.dumps(entry) for entry in served.rest.get("/api/log", params={"count": 10}).json()]
    assert any("/api/stop" in entry for entry in told), told
