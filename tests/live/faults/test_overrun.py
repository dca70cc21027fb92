"""Deadline overrun: counted, whole periods skipped, never a burst; HOLD and FAULT when there are too many."""

import signal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from station.config.controllers import PERIOD
from station.control.overruns import OverrunLimits, Overruns
from station.devices.interfaces import Severity
from station.recording.read import read_case
from tests.harness.calm import CLOCK
from tests.harness.kill_stations import until_moving
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until


class Look(NamedTuple):
    after: int  #: ticks
    severity: Severity


def looks(skips: list[int]) -> list[Look]:
    """What comes of ticks that each skip so many periods."""
    overruns = Overruns(OverrunLimits(), PERIOD)
    found, now = [], 0.0
    for tick, skipped in enumerate(skips, 1):
        now += PERIOD * (1 + skipped)
        trouble = overruns.look(now, skipped)
        if trouble is not None:
            found.append(Look(tick, trouble.severity))
    return found


def test_five_in_a_row_hold_and_twenty_in_a_row_are_a_fault() -> None:
    found = looks([1] * 20)
    assert found[0] == Look(5, Severity.HOLD)
    assert found[-1] == Look(20, Severity.FAULT)
    assert looks([1, 1, 1, 1, 0] * 9) == []


def test_one_per_cent_in_ten_seconds_holds() -> None:
    assert looks([0, 0, 49] + [0] * 100) == []
    (found,) = looks([0] * 100 + [1, 0] * 51)
    assert found == Look(201, Severity.HOLD)


def test_a_loop_that_does_not_get_its_time_skips_whole_periods_and_the_motion_is_held(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run, control = mortal.ask("status")["run"], mortal.child("control")

    def held_up() -> dict[str, Any] | None:
        """Where fifty ticks have brought it to, if it is no longer on; the devices bear so many."""
        control.send_signal(signal.SIGSTOP)
        CLOCK.sleep(0.1)
        control.send_signal(signal.SIGCONT)
        CLOCK.sleep(0.1)
        status = mortal.ask("status")
        return status if status["state"] != "RUNNING" else None

    status = until(held_up, "a HOLD")
    assert status is not None
    assert status["state"] == "HOLD"
    assert "the control loop has missed " in status["cause"]
    assert "see ctr-station doctor" in status["cause"]
    times = read_case(until(lambda: next(recordings.glob(f"{run}/run.mcap"), None), run)).rows[:, 0]
    steps = np.round(np.diff(times) / PERIOD)
    # every row is one period later than the one before, or a whole number of them: none twice, none in between
    assert (steps >= 1.0).all()
    assert np.diff(times) == pytest.approx(steps * PERIOD, abs=1e-9)
    assert steps.max() >= 0.05 / PERIOD
