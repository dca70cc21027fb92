"""Going to a pose in joints: tried on the model first, all joints at the same time, then carried out like a motion.

The working pose is that of the robot's file: where motions have room, and where the station goes after homing.
"""

import math

import numpy as np

from core.errors import CtrError
from core.model.statics import Solution
from core.robot.robot import Array
from station.config.motions import HoldMotion, Orders
from station.config.robots import named_pose
from station.config.strict import ConfigError
from station.control.task import Task
from station.service.bench import Bench
from station.service.start import Start

#: Between two looks of the model at the way: what the quickest joint takes for it at top speed [s].
STEP = 0.1
#: The tip does not jump by more than this between two looks [m]; curvature of its path makes a tenth of it.
JUMP = 2e-3


def to_working_pose(bench: Bench) -> Start:
    """The way to the working pose.

    Raises:
        ConfigError: the robot's file has none.
    """
    robot = bench.robot
    if robot.working_pose is None:
        raise ConfigError(
            f"robot '{robot.name}' has no working_pose: add one to its file, all joints by name [rad or m],"
            " or say which joints to go to"
        )
    return to_joints(bench, named_pose(robot.working_pose, robot, "working_pose"), "to the working pose")


def to_joints(bench: Bench, target: Array, title: str) -> Start:
    """The way to `target` (n,) [rad or m]; neither recorded nor tared, and what hangs at the tip stays.

    Raises:
        PoseError: outside the joints' travel, or the tubes cannot stand there.
    """
    controller = bench.controlled(bench.controller)
    controller.limits.check(target)
    robot = controller.statics.robot
    robot.check_pose(target)
    task = Task(controller, Orders(HoldMotion(), robot), 0.0, target, rests=False)
    return Start(task, title, load=None, recorded=False)


def check_way(bench: Bench, start: Start, joints: Array) -> None:
    """Refuse a way from `joints` (n,) [rad or m] on which the tubes would snap.

    Travel and the order of the tubes are kept between two poses that keep them.

    Raises:
        ConfigError: where on the way, and what is in the way there.
    """
    task, statics = start.task, start.task.controller.statics
    assert task.start is not None, "going there needs a where"  # noqa: S101
    way, least = task.start - joints, bench.margins.stability
    steps = max(1, math.ceil(np.abs(way / task.controller.limits.speed).max() / STEP))
    at = None
    for number in range(steps + 1):
        place, before = f"{start.title}: after {100 * number / steps:.0f} % of the way", at
        try:
            at = statics.solve(joints + number / steps * way, np.zeros(6), before)
        except CtrError as error:
            raise ConfigError(f"{place}: {error}; go there by way of another pose") from None
        # A fold that lies between two looks shows as a tip that the Jacobian did not foresee.
        jump = 0.0 if before is None else _unforeseen(before, at)
        if at.stability < least or jump > JUMP:
            raise ConfigError(
                f"{place} the tubes would snap, or nearly (stability {at.stability:.2g}, at least {least:g};"
                f" jump of {1e3 * jump:.1f} mm); go there by way of another pose"
            )


def _unforeseen(before: Solution, at: Solution) -> float:
    """How far the tip is from where the Jacobian of the look before has it [m]."""
    foreseen = before.tip + before.jacobian[:3] @ (at.joints - before.joints)
    return float(np.linalg.norm(at.tip - foreseen))
