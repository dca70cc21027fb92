"""Faults that end a run in HOLD: a lost operator, a lost recorder, a full disk, and a late control loop.

The operator's loss ends a run only if the station file configures that; `tests/live/web/api` tests the other case. On a
full disk the free space is checked before a start, and the written part of a run is kept and labelled *incomplete*. A
late control loop skips whole periods and never executes the missed ticks in a burst.
"""

import os
import resource
import signal
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.process import ring_width
from station.control.realtime import request_fifo
from station.control.ring import Ring
from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_outcome import RecordingError, RunOutcome
from station.service.runs import LiveRecording
from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
from tests.tools.kill_stations import back, until_moving


def test_run_ends_in_hold_after_the_operator_disconnects_if_so_configured(mortal: LoneStation) -> None:
    until_moving(mortal)
    mortal.ask("gone")
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    assert status["state"] == "HOLD"
    assert "the operator has disconnected" in status["cause"]


def test_reset_restarts_a_recorder_that_was_killed_between_two_runs(mortal: LoneStation) -> None:
    mortal.child("recorder").kill()
    answer = mortal.ask("reset")
    assert answer["note"] == "restarted: the recorder"
    assert answer["state"] == "READY"
    until_moving(mortal)
    back_to_ready(mortal)
    assert mortal.ask("reset")["refused"] != ""  # the station is READY, so there is nothing to reset


def test_run_ends_in_hold_when_the_recorder_is_suspended_and_a_reset_replaces_the_recorder(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    mortal.child("recorder").send_signal(signal.SIGSTOP)
    status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    assert status["state"] == "HOLD"
    assert status["cause"] == "the process of the recorder was suspended, and all axes were stopped"
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


def test_recording_larger_than_the_free_space_is_refused_before_the_run(paper) -> None:
    ring = Ring(ring_width(paper))
    # Ten days of telemetry need 347 GB, which is more than a file system in memory has.
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        recording = LiveRecording(ring, paper, Path(folder), CLOCK)
        try:
            with pytest.raises(
                RecordingError, match=r"MB are free, a recording of 864000 s needs 3\d{5} MB; delete old"
            ):
                recording.begin("long", 864000.0, 0.0, {})
        finally:
            recording.close()
            ring.close(remove=True)


def test_run_that_fills_the_disk_ends_in_hold_and_its_written_part_is_kept(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    (partial,) = recordings.glob(f"{run}*/run.mcap.partial")
    recorder, unlimited = mortal.child("recorder").pid, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    # This limit simulates a disk on which 100 kB are free.
    most = partial.stat().st_size + 100_000
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    finally:
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, unlimited)
    assert status["state"] == "HOLD"
    assert status["cause"].startswith("the recording has ended: ")
    assert "the recording cannot be continued" in status["cause"]
    assert mortal.ask("reset")["state"] == "READY"
    recover(recordings)
    (kept,) = recordings.glob(f"{run}*/run.mcap")
    last = read_case(kept)
    assert last.label is RunOutcome.INCOMPLETE
    assert len(last.rows) > 500


def test_suspended_control_loop_skips_whole_periods_and_its_motion_ends_in_hold(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run, control = mortal.ask("status")["run"], mortal.child("control")

    def held_up() -> dict[str, Any] | None:
        """Suspend the control process for fifty periods; return the status if the run has ended.

        A longer suspension would make the devices count as lost, so no other program may delay this process meanwhile.
        """
        request_fifo(60)
        control.send_signal(signal.SIGSTOP)
        CLOCK.sleep(0.1)
        control.send_signal(signal.SIGCONT)
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        CLOCK.sleep(0.1)
        status = mortal.ask("status")
        return status if status["state"] != "RUNNING" and status["cause"] else None

    status = until(held_up, "a HOLD")
    assert status is not None
    assert status["state"] == "HOLD"
    assert status["cause"].startswith("this computer was too busy: the control loop missed ")
    assert "run 'ctr-station doctor'" in status["cause"]
    assert status["details"].startswith("load ")
    times = read_case(until(lambda: next(recordings.glob(f"{run}/run.mcap"), None), run)).rows[:, 0]
    steps = np.round(np.diff(times) / PERIOD_S)
    # Two consecutive rows differ by a whole number of periods: no tick is repeated, and none is between two deadlines.
    assert (steps >= 1.0).all()
    assert np.diff(times) == pytest.approx(steps * PERIOD_S, abs=1e-9)
    assert steps.max() >= 0.05 / PERIOD_S
