"""The station process and the control process: each stops the axes when the other is killed or suspended.

A station process that is only busy does not end a run. A reset starts another control process.
"""

import os
import signal
from pathlib import Path

import psutil

from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_outcome import RunOutcome
from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation, lone_station
from tests.harness.serving import shared_memory
from tests.harness.waiting import NET, until
from tests.harness.watched_lab import WatchedLab
from tests.tools.kill_stations import back, kill, until_moving


def label(recordings: Path, run: str) -> RunOutcome:
    """Return the outcome of a run after its recording is finished."""
    return read_case(until(lambda: next(recordings.glob(f"{run}/run.mcap"), None), run)).label


def test_stages_stop_after_a_kill_of_the_control_process_and_a_reset_starts_another(
    mortal: LoneStation, watched_lab: WatchedLab, recordings: Path
) -> None:
    killed, known = mortal.child("control").pid, set((recordings / "last_seconds").glob("*.csv"))
    assert kill(mortal, watched_lab, "control", 0.3) > 0.0
    status = until(lambda: (now := mortal.ask("status"))["state"] == "FAULT" and now)
    assert status["cause"].startswith("the control process ended by signal 9; ")
    status = until(lambda: "being stopped" not in (now := mortal.ask("status"))["cause"] and now)
    assert "the control process ended by signal 9; 3 stages on" in status["cause"]
    assert label(recordings, status["run"]) is RunOutcome.INTERRUPTED
    back(mortal)
    assert mortal.child("control").pid != killed
    (kept,) = until(lambda: set((recordings / "last_seconds").glob("*-fault.csv")) - known)
    until(lambda: len(kept.read_text().splitlines()) > 400)  # the station may still be writing it
    assert kept.read_text().startswith("# the control process ended by signal 9")


def test_stages_stop_and_the_run_is_interrupted_when_the_control_process_is_suspended(
    mortal: LoneStation, watched_lab: WatchedLab, recordings: Path
) -> None:
    until_moving(mortal, watched_lab)
    begin = watched_lab.clock.now()
    mortal.child("control").send_signal(signal.SIGSTOP)
    assert watched_lab.stop_delay(begin) > 0.0
    status = until(lambda: (now := mortal.ask("status"))["state"] == "FAULT" and now["cause"] and now)
    assert status["cause"].startswith("the control process was suspended; ")
    assert label(recordings, status["run"]) is RunOutcome.INTERRUPTED
    back(mortal)


def test_control_process_stops_the_stages_of_a_killed_station_and_the_next_start_recovers_the_run(
    tmp_path: Path,
) -> None:
    with WatchedLab(CLOCK) as lab:
        with lone_station(tmp_path, lab) as station:
            used = shared_memory(station.process.pid)
            children = [station.child(name) for name in ("control", "guard", "recorder")]
            assert kill(station, lab, "station", 0.4) > 0.0
            assert psutil.wait_procs(children, timeout=NET)[1] == []
            assert used
            until(lambda: not any(path.exists() for path in used))
        with lone_station(tmp_path, lab) as station:
            assert (
                len(station.ask("status")["recovered"]) <= 1
            )  # 0 if the recorder could still finish the recording itself
            (first,) = runs(tmp_path)
            until_moving(station, lab)
            # Kill every process at once, so that no process can finish the recording.
            everybody = [station.child(name) for name in ("control", "guard", "recorder")]
            for pid in (station.process.pid, *(process.pid for process in everybody)):
                os.kill(pid, signal.SIGKILL)
            assert psutil.wait_procs(everybody, timeout=NET)[1] == []
    until(lambda: not [path for path in tmp_path.glob("*.partial") if not recover(tmp_path).folders])
    found = runs(tmp_path)
    assert len(found) == 2
    assert first in found
    for run in found:
        read = read_case(run / "run.mcap")
        assert read.label is RunOutcome.INTERRUPTED
        assert len(read.rows) > 0
        assert (read.rows[1:, 0] > read.rows[:-1, 0]).all()


def test_run_continues_while_another_thread_keeps_the_interpreters_lock_of_the_station_process(
    mortal: LoneStation, watched_lab: WatchedLab
) -> None:
    until_moving(mortal, watched_lab)
    status = mortal.ask("busy")
    assert status["state"] == "RUNNING", status
    assert mortal.ask("stop")["state"] == "STOPPED"


def test_stages_stop_and_the_run_ends_when_the_station_process_is_suspended(
    mortal: LoneStation, watched_lab: WatchedLab
) -> None:
    until_moving(mortal, watched_lab)
    begin = watched_lab.clock.now()
    mortal.process.send_signal(signal.SIGSTOP)
    try:
        assert watched_lab.stop_delay(begin) > 0.0
    finally:
        mortal.process.send_signal(signal.SIGCONT)
    status = until(lambda: (now := mortal.ask("status"))["state"] == "STOPPED" and now["cause"] and now)
    assert status["cause"] == "the station process was suspended, and all axes were stopped"


def runs(folder: Path) -> list[Path]:
    """Return the folders of the finished runs."""
    return [path.parent for path in folder.glob("*/run.mcap")]
