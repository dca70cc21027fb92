"""Near a singular pose the joint velocities are damped and stay within their limits.

The motion ends in HOLD only if the pose stays singular and the tip comes no nearer to its setpoint.
"""

import numpy as np

from core.control.velocity_ik import SIGMA_FLOOR_M_S
from station.config.motions import HoldMotion, Orders, StepMotion
from station.control.states import State
from station.control.task import MotionTask, Phase
from tests.harness.virtual_station import VirtualStation

#: Singular pose: both tubes bend in the same direction. The tip can leave the plane of their curves only if both tubes
#: rotate, and at the end of the travel it cannot move along the tubes either.
ALIGNED = np.array([0.0, 0.0, -0.1])


def test_joint_speeds_stay_within_their_limits_near_a_singular_pose(virtual: VirtualStation) -> None:
    virtual.ready()
    robot = virtual.case.robot.robot()
    task = MotionTask(virtual.case.controller, Orders(HoldMotion(), robot), 0.5, ALIGNED)
    virtual.loop.start(task)
    virtual.until(lambda: virtual.state is State.READY, 30.0)
    begin = len(virtual.rows)
    away = StepMotion(offset=(0.0, -0.03, 0.0))  # toward the tubes' centre of curvature
    virtual.loop.start(MotionTask(virtual.case.controller, Orders(away, robot), 20.0))
    virtual.until(lambda: virtual.state is not State.RUNNING, 30.0)
    rows = virtual.rows[begin:]
    moving = [row for row in rows if virtual.of("sigma", [row])[0, 0] > 0.0]

    limits = virtual.case.controller.limits
    assert (np.abs(virtual.of("velocity_commanded", rows)) <= limits.speed * (1 + 1e-9)).all()
    assert len(moving) > 100
    assert virtual.of("sigma", moving)[:, -1].min() < SIGMA_FLOOR_M_S
    assert virtual.state is State.HOLD
    assert "singular pose, sigma" in virtual.loop.cause
    assert "has not come nearer for 5 s; move the target or start elsewhere" in virtual.loop.cause
    assert virtual.loop.phase is Phase.NONE
    virtual.seconds(0.4)
    assert virtual.rests()
