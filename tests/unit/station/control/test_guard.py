"""A watch ends for every installed driver: one whose emergency stop fails in any way, and one without any.

The watch of a process that ends with the station waits for the stop of the stages by a process before it.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from station.config.robots import RobotFile
from station.control import guard
from station.control.clock import REAL_TIME_CLOCK
from station.control.guard import ATTEMPTS, FINISH_S, Rank, Watch, brief
from station.control.ring import DRIVER, WATCHERS, Ring
from station.devices.config import BenchFile
from tests.harness.bad_stops import MANNERS
from tests.harness.entry_points import install_entry_points

ENTRIES = {
    "bad-stops": "tests.harness.bad_stops:open_stages",
    "no-emergency-stop": "tests.unit.station.control.test_guard:open_without_emergency_stop",
}


def open_without_emergency_stop(*_: Any) -> None:
    raise AssertionError("these stages are never opened")


@pytest.fixture
def ring() -> Iterator[Ring]:
    """A ring whose control process has been killed; its process ID is not given to another process meanwhile."""
    ring = Ring(1)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as control:
        control.send_signal(signal.SIGKILL)
        ring.counters[DRIVER] = control.pid
        yield ring
    ring.close(remove=True)


@pytest.mark.parametrize("manner", [*(one for one in MANNERS if one != "hangs"), "no emergency stop"])
def test_watch_ends_and_only_a_text_is_evidence_of_a_stop(
    ring: Ring,
    paper: RobotFile,
    manner: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(guard, "LOOK_INTERVAL_S", 0.001)
    monkeypatch.syspath_prepend(str(tmp_path))
    install_entry_points(tmp_path, {"ctr_station.devices": ENTRIES})
    known = manner in MANNERS
    stages = {"driver": "bad-stops", "manner": manner} if known else {"driver": "no-emergency-stop"}
    brief(ring, BenchFile(stages=stages), paper)

    Watch(ring, Rank.GUARD, REAL_TIME_CLOCK).finish()

    reports = capsys.readouterr().err.splitlines()
    stopped = manner == "lies"
    assert bool(ring.counters[DRIVER]) is not stopped
    assert len(reports) == (1 if stopped else ATTEMPTS if known else 0)


class Waits:
    """A clock on which each wait takes `FINISH_S`, and something happens during the first one."""

    def __init__(self, happens: Callable[[], object]) -> None:
        self._happens, self.waits = happens, 0

    def now(self) -> float:
        return FINISH_S * self.waits

    def sleep(self, _: float) -> None:
        self.waits += 1
        if self.waits == 1:
            self._happens()


@pytest.mark.parametrize(
    ("guard_ends", "station_runs", "stopped", "waits"),
    [(True, False, True, 1), (True, True, False, 1), (False, False, False, 2)],
    ids=["the guard is killed before it has stopped them", "the station runs", "the guard needs too long"],
)
def test_a_process_that_ends_waits_for_the_stop_of_the_stages(
    ring: Ring, paper: RobotFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    guard_ends: bool, station_runs: bool, stopped: bool, waits: int,
) -> None:  # fmt: skip
    monkeypatch.syspath_prepend(str(tmp_path))
    install_entry_points(tmp_path, {"ctr_station.devices": ENTRIES})
    brief(ring, BenchFile(stages={"driver": "bad-stops", "manner": "lies"}), paper)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as another:
        ring.counters[WATCHERS + Rank.STATION] = os.getpid() if station_runs else ring.counters[DRIVER]
        ring.counters[WATCHERS + Rank.GUARD] = os.getpid() if station_runs else another.pid
        clock: Any = Waits(another.kill if guard_ends else lambda: None)
        Watch(ring, Rank.RECORDER, clock).finish()
        another.kill()
    assert (not ring.counters[DRIVER], clock.waits) == (stopped, waits)
