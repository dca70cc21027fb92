"""Ticks of the control loop that start too late are overruns; too many overruns cause HOLD or FAULT.

A late loop skips whole periods and never executes the missed ticks in a burst.
"""

import os
import signal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.monitors import OverrunLimits, Overruns
from station.control.realtime import request_fifo
from station.devices.interfaces import Severity
from station.recording.read import read_case
from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
from tests.tools.kill_stations import until_moving


class Report(NamedTuple):
    after: int  #: number of ticks until the fault
    severity: Severity


def reports(skips: list[int]) -> list[Report]:
    """Return the faults after a sequence of ticks; `skips` has the number of periods that each tick skips."""
    overruns = Overruns(OverrunLimits(), PERIOD_S)
    found, now = [], 0.0
    for tick, skipped in enumerate(skips, 1):
        now += PERIOD_S * (1 + skipped)
        trouble = overruns.check(now, skipped)
        if trouble is not None:
            found.append(Report(tick, trouble.severity))
    return found


def test_five_consecutive_overruns_cause_hold_and_twenty_cause_fault() -> None:
    found = reports([1] * 20)
    assert found[0] == Report(5, Severity.HOLD)
    assert found[-1] == Report(20, Severity.FAULT)
    assert reports([1, 1, 1, 1, 0] * 9) == []


def test_more_than_one_percent_of_missed_periods_in_ten_seconds_causes_hold() -> None:
    assert reports([0, 0, 49] + [0] * 100) == []
    (found,) = reports([0] * 100 + [1, 0] * 51)
    assert found == Report(201, Severity.HOLD)


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
