"""Singular pose: damped, joint speeds capped, sigma shown; HOLD only when it lasts and the tip comes no nearer."""

import numpy as np

from core.control.inverse import SIGMA_FLOOR
from station.config.motions import HoldMotion, Orders, StepMotion
from station.control.states import State
from station.control.task import Phase, Task
from tests.harness.virtual_station import VirtualStation

#: Both tubes bend the same way: the tip cannot leave the plane of their curves but by turning both, and at the
#: end of the travel not along the tubes either.
ALIGNED = np.array([0.0, 0.0, -0.1])


def test_speeds_stay_within_their_limits_near_a_singular_pose(virtual: VirtualStation) -> None:
    virtual.ready()
    robot = virtual.case.robot.robot()
    task = Task(virtual.case.controller, Orders(HoldMotion(), robot), 0.5, ALIGNED)
    virtual.loop.start(task)
    virtual.until(lambda: virtual.state is State.READY, 30.0)
    begin = len(virtual.rows)
    away = StepMotion(offset=(0.0, -0.03, 0.0))  # toward the tubes' centre of curvature
    virtual.loop.start(Task(virtual.case.controller, Orders(away, robot), 20.0))
    virtual.until(lambda: virtual.state is not State.RUNNING, 30.0)
    rows = virtual.rows[begin:]
    moving = [row for row in rows if virtual.of("sigma", [row])[0, 0] > 0.0]

    limits = virtual.case.controller.limits
    assert (np.abs(virtual.of("velocity_commanded", rows)) <= limits.speed * (1 + 1e-9)).all()
    assert len(moving) > 100
    assert virtual.of("sigma", moving)[:, -1].min() < SIGMA_FLOOR
    assert virtual.state is State.HOLD
    assert "singular pose, sigma" in virtual.loop.cause
    assert "has not come nearer for 5 s; move the target or start elsewhere" in virtual.loop.cause
    assert virtual.loop.phase is Phase.NONE
    virtual.seconds(0.4)
    assert virtual.rests()
