"""What is measured at a pose where the robot rests: averages, and how far they can be trusted."""

from typing import NamedTuple

import numpy as np

from core.control.force_fusion import fuse_at
from core.robot.robot import Array, Robot


class Measurement(NamedTuple):
    """One pose at rest, as the devices saw it; nothing here comes from a model."""

    time: float  #: of the middle of the averages [s]
    joints: Array  #: (n,) as the stages count them [rad or m]
    coil: Array  #: (3,) in the tracker's frame [m]
    wrenches: Array  #: (q, 6) in the sensors' axes, untared [N, N m]
    weight: float | None  #: known to hang at the tip, 0 for nothing; None: an unknown load [N]
    came: Array | None = None  #: (n,) -1, 0, 1: which way each joint moved last; a drive with play is behind
    axes: Array | None = None  #: (1, 3) or (3, 3) directions of the coil, tracker's frame: its axis, or x, y, z


class Noise(NamedTuple):
    """Standard deviations of a measurement's averages."""

    coil: float = 0.02e-3  #: each axis of the position [m]
    axes: float = 2e-3  #: each component of a direction [rad]
    force: float = 2e-3  #: each component of the fused load [N]
    moment: float = 0.1e-3  #: [N m]

    def scaled(self, factor: float) -> "Noise":
        """As much more of all of it."""
        return Noise(*(factor * each for each in self))


def stacked(measurements: list[Measurement]) -> tuple[Array, Array]:
    """Joints (m, n) and coil positions (m, 3)."""
    return np.array([v.joints for v in measurements]), np.array([v.coil for v in measurements])


def fused_forces(robot: Robot, measurements: list[Measurement]) -> Array:
    """Load at the tip (m, 3) of tared measurements, world frame [N]."""
    return np.array([fuse_at(robot, v.joints, v.wrenches).force for v in measurements])
