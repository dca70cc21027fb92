"""A run ends in HOLD when the recorder dies or hangs. A reset starts another recorder, which records the next run."""

import signal
from pathlib import Path

from station.recording.read import read_case
from station.recording.run_outcome import RunOutcome
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
from tests.tools.kill_stations import back, until_moving


def test_reset_restarts_a_recorder_that_was_killed_between_two_runs(mortal: LoneStation) -> None:
    mortal.child("recorder").kill()
    answer = mortal.ask("reset")
    assert answer["note"] == "restarted: the recorder"
    assert answer["state"] == "READY"
    until_moving(mortal)
    back_to_ready(mortal)
    assert mortal.ask("reset")["refused"] != ""  # the station is READY, so there is nothing to reset


def test_run_ends_in_hold_when_the_recorder_hangs_and_a_reset_replaces_the_recorder(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    mortal.child("recorder").send_signal(signal.SIGSTOP)
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    assert status["state"] == "HOLD"
    assert "the recorder has not responded for 3 s" in status["cause"]
    answer = mortal.ask("reset")
    assert answer["note"] == "restarted: the recorder"
    assert answer["state"] == "READY"
    (kept,) = recordings.glob(f"{run}*/run.mcap")
    assert read_case(kept).label is RunOutcome.INTERRUPTED
    until_moving(mortal)
    back_to_ready(mortal)


def back_to_ready(station: LoneStation) -> None:
    station.ask("stop")
    back(station)
