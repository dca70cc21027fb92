"""A motion that holds a force: the true force stays, and the bound also applies to what the estimate cannot know."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from station.config.loads import WallLoad
from station.control.states import RefusedError, State
from station.control.task import MotionTask
from tests.harness.ideal_station import IdealStation, Kind

FORCE_N = 0.2
ALONG = (0.0, 0.0, 1.0)
WALL = WallLoad(direction=(0.0, 0.0, -1.0), distance=0.002, stiffness=1000.0)


def drifting(task: MotionTask, rate: float) -> MotionTask:
    """Return the task with a controller that expects a drift of the forces at `rate` [N/s]."""
    estimator = task.controller.estimator
    load = replace(estimator.load, errors=replace(estimator.load.errors, force_drift=rate))
    return replace(task, controller=replace(task.controller, estimator=replace(estimator, load=load)))


def test_a_force_that_is_held_along_the_robot_does_not_become_drift() -> None:
    station = IdealStation()
    station.lab.apply_load(WALL, station.now)
    station.loop.start(station.pressing(ALONG, FORCE_N, 100.0))
    station.until(lambda: station.state is not State.RUNNING, most=120.0)
    assert station.state is State.READY
    assert station.true_size == pytest.approx(FORCE_N, abs=5e-4)


@pytest.mark.parametrize("without", [(), ("tracker",)])
def test_a_force_that_drift_may_have_raised_above_the_bound_ends_the_motion(without: Sequence[Kind]) -> None:
    station = IdealStation(without, bound=FORCE_N + 0.05)
    station.lab.apply_load(WALL, station.now)
    began = station.now
    station.loop.start(drifting(station.pressing(ALONG, FORCE_N, 600.0, speed=1e-3), 50e-3 / 60.0))
    station.end()
    assert station.state is State.HOLD
    # Two sensors that drift by 50 mN in a minute: two standard deviations of their sum are 50 mN after 21 s.
    assert station.now - began == pytest.approx(21.0, abs=6.0)
    assert f"is above {station.bound:.2g} N (the bound of this test); 0.2 N are measured" in station.loop.cause
    station.loop.reset(station.now)
    with pytest.raises(RefusedError, match="zero the force"):
        station.loop.start(station.holding(1.0))
    station.jog("tip", (0.0, 0.0, -4e-3), 2.0)
    assert station.true_size == 0.0
    station.loop.tare(station.now, untouched=True)
    station.seconds(2.0)
    station.loop.start(station.holding(1.0))
    station.end()
    assert station.state is State.READY
    assert np.linalg.norm(station.true, axis=1).max() < station.bound
