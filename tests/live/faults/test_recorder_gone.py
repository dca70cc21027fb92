"""Recorder killed or hung: the run ends in HOLD; a reset starts another, and the next run is recorded."""

import signal
from pathlib import Path

from station.recording.label import Label
from station.recording.read import read_case
from tests.harness.kill_stations import back, until_moving
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until


def test_one_that_died_while_nothing_was_recorded_is_started_anew_by_a_reset(mortal: LoneStation) -> None:
    mortal.child("recorder").kill()
    answer = mortal.ask("reset")
    assert answer["note"] == "started anew: the recorder"
    assert answer["state"] == "READY"
    until_moving(mortal)
    back_to_ready(mortal)
    assert mortal.ask("reset")["refused"] != ""  # there is nothing to reset now


def test_one_that_stands_still_is_noticed_in_the_run_and_replaced(mortal: LoneStation, recordings: Path) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    mortal.child("recorder").send_signal(signal.SIGSTOP)
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now)
    assert status["state"] == "HOLD"
    assert "the recorder has stood still for 3 s" in status["cause"]
    answer = mortal.ask("reset")
    assert answer["note"] == "started anew: the recorder"
    assert answer["state"] == "READY"
    (kept,) = recordings.glob(f"{run}*/run.mcap")
    assert read_case(kept).label is Label.INTERRUPTED
    until_moving(mortal)
    back_to_ready(mortal)


def back_to_ready(station: LoneStation) -> None:
    station.ask("stop")
    back(station)
