"""Station process killed: the control process stops the axes and ends; the next start has the recording."""

import os
import signal
from pathlib import Path

import psutil

from station.recording.label import Label
from station.recording.read import read_case
from station.recording.recover import recover
from tests.harness.calm import CLOCK
from tests.harness.kill_stations import kill, until_moving
from tests.harness.lone_station import lone_station
from tests.harness.serving import shared_memory
from tests.harness.waiting import NET, until
from tests.harness.watched_lab import WatchedLab


def test_the_control_process_stops_the_stages_and_the_next_start_has_the_recording(tmp_path: Path) -> None:
    with WatchedLab(CLOCK) as lab:
        with lone_station(tmp_path, lab) as station:
            used = shared_memory(station.process.pid)
            children = [station.child(name) for name in ("control", "recorder")]
            assert kill(station, lab, "station", 0.4) > 0.0
            assert psutil.wait_procs(children, timeout=NET)[1] == []
            assert used
            until(lambda: not any(path.exists() for path in used))
        with lone_station(tmp_path, lab) as station:
            assert len(station.ask("status")["recovered"]) <= 1  # none, if the recorder could still finish it
            (first,) = runs(tmp_path)
            until_moving(station, lab)
            # All of them at once: nobody finishes anything.
            everybody = [station.child(name) for name in ("control", "recorder")]
            for pid in (station.process.pid, *(process.pid for process in everybody)):
                os.kill(pid, signal.SIGKILL)
            assert psutil.wait_procs(everybody, timeout=NET)[1] == []
    until(lambda: not [path for path in tmp_path.glob("*.partial") if not recover(tmp_path)])
    found = runs(tmp_path)
    assert len(found) == 2
    assert first in found
    for run in found:
        read = read_case(run / "run.mcap")
        assert read.label is Label.INTERRUPTED
        assert len(read.rows) > 0
        assert (read.rows[1:, 0] > read.rows[:-1, 0]).all()


def runs(folder: Path) -> list[Path]:
    """Those that are finished."""
    return [path.parent for path in folder.glob("*/run.mcap")]
