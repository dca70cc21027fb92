"""Motion to a joint-space pose: the path is checked on the model first, and all joints move at the same time.

The robot's file defines the working pose, which leaves room for motions. The station moves to this pose after homing.
"""

import math

import numpy as np

from core.control.reachability import check_pose, situation
from core.errors import CtrError, PoseError
from core.model.statics import Solution
from core.robot.limits import Limits
from core.robot.robot import Array
from station.config.motions import HoldMotion, Orders
from station.config.robots import named_pose
from station.config.strict import ConfigError
from station.control.task import MotionTask
from station.service.rig import Rig
from station.service.run_request import StartRequest

#: Interval between two checked poses of a path, as the longest travel time of a joint at top speed [s].
PATH_STEP_S = 0.1
#: Largest error of the tip position that the Jacobian predicts from one checked pose to the next [m]; a larger error
#: is a snap. The curvature of a valid path causes a tenth of this error.
MAX_TIP_JUMP_M = 2e-3


def goto_working_pose(bench: Rig) -> StartRequest:
    """Return the start request of the motion to the working pose.

    Raises:
        ConfigError: the robot's file has no working pose.
    """
    robot = bench.robot
    if robot.working_pose is None:
        raise ConfigError(
            f"robot '{robot.name}' has no working_pose: add one to its file, all joints by name [rad or m],"
            " or name the joint positions to go to"
        )
    return goto_joints(bench, named_pose(robot.working_pose, robot, "working_pose"), "to the working pose")


def goto_joints(bench: Rig, target: Array, title: str) -> StartRequest:
    """Return the start request of the motion to `target` (n,) [rad or m], without recording, tare or change of load.

    Raises:
        PoseError: the target violates a limit of the robot.
    """
    controller = bench.controlled(bench.controller)
    check_pose(controller.statics, controller.limits, target)
    task = MotionTask(controller, Orders(HoldMotion(), controller.statics.robot), 0.0, target, rests=False)
    return StartRequest(task, title, load=None, recorded=False)


def check_path(bench: Rig, start: StartRequest, joints: Array) -> None:
    """Refuse a path from `joints` (n,) [rad or m] on which the tubes would snap, or which leaves a limit.

    A path that starts outside a limit may lead back inside.

    Raises:
        ConfigError: the path is refused; the text names the part of the path and the reason.
    """
    task, statics = start.task, start.task.controller.statics
    limits, inside = task.controller.limits, False
    assert task.start is not None, "a motion to a pose needs a target"  # noqa: S101
    travel, minimum = task.start - joints, bench.margins.stability
    steps = max(1, math.ceil(np.abs(travel / task.controller.limits.speed).max() / PATH_STEP_S))
    at = None
    for number in range(steps + 1):
        position, before = f"{start.title}: after {100 * number / steps:.0f} % of the path", at
        try:
            at = statics.solve(joints + number / steps * travel, np.zeros(6), before)
            inside = _is_inside(limits, at, required=inside)
        except CtrError as error:
            raise ConfigError(f"{position}: {error}; go there via another pose") from None
        # A snap between two checked poses appears as a large prediction error of the Jacobian.
        jump = 0.0 if before is None else _prediction_error(before, at)
        if at.stability < minimum or jump > MAX_TIP_JUMP_M:
            raise ConfigError(
                f"{position} the tubes would snap, or nearly (stability {at.stability:.2g}, at least {minimum:g};"
                f" jump of {1e3 * jump:.1f} mm); go there via another pose"
            )


def _is_inside(limits: Limits, at: Solution, *, required: bool) -> bool:
    """Return whether the pose `at` satisfies every limit; raise PoseError if it does not and `required` is set."""
    try:
        limits.check_all(situation(at))
    except PoseError:
        if required:
            raise
        return False
    return True


def _prediction_error(before: Solution, at: Solution) -> float:
    """Return the distance of the tip from the position that the previous pose's Jacobian predicts [m]."""
    predicted = before.tip + before.jacobian[:3] @ (at.joints - before.joints)
    return float(np.linalg.norm(at.tip - predicted))
