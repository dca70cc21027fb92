"""The station process reacts to a killed or hung control process: it stops the axes and marks the run as interrupted.

A reset then starts another control process.
"""

import re
import signal
from pathlib import Path

from station.recording.read import read_case
from station.recording.run_outcome import RunOutcome
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
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
    until(lambda: len(kept.read_text().splitlines()) > 400)  # the station writes it meanwhile
    assert kept.read_text().startswith("# the control process ended by signal 9")


def test_stages_stop_and_the_run_is_interrupted_when_the_control_process_hangs(
    mortal: LoneStation, watched_lab: WatchedLab, recordings: Path
) -> None:
    until_moving(mortal, watched_lab)
    begin = watched_lab.clock.now()
    mortal.child("control").send_signal(signal.SIGSTOP)
    assert watched_lab.stop_delay(begin) > 0.0
    status = until(lambda: (now := mortal.ask("status"))["state"] == "FAULT" and now["cause"] and now)
    # A watchdog that was delayed finds a longer silence.
    assert re.match(r"this computer was too busy: the control loop was silent for \d+\.\d s", status["cause"])
    assert label(recordings, status["run"]) is RunOutcome.INTERRUPTED
    back(mortal)
