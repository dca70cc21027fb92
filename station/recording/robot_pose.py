"""Pose of the robot for one telemetry row: poses of plate, tip and tube bases, and centre lines of the tubes.

The loaded model computes the shape from the measured joint positions and the filtered force, as for the scene on the
operator's page.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.control.telemetry import Channel

Pose = tuple[Sequence[float], Sequence[float]]  #: pose as position [m] and quaternion x, y, z, w


class RobotPose(NamedTuple):
    """Poses and centre lines of the robot's parts in the world frame."""

    plate: Pose
    tip: Pose  #: pose of the tip that the model computes
    bases: tuple[Pose, ...]  #: pose of each tube's base, which rotates with the tube
    lines: tuple[Array, ...]  #: centre line of each tube, from its base to its end (k, 3) [m]


class PoseReader:
    """Computes the poses of one robot from telemetry rows."""

    def __init__(self, robot: Robot, channels: Sequence[Channel]) -> None:
        self._robot, self._statics = robot, Statics(robot)
        self._near: Solution | None = None
        self._wrench = np.zeros(6)
        rotation = robot.layout.base[:9].reshape(3, 3)
        self._plate, self._forward = np.array(robot.base.position), rotation[:, 2]
        self._upright = quaternion_of(rotation)
        self._joints, self._force = columns_of(channels, "joints"), columns_of(channels, "force_filtered")

    def of(self, row: Array) -> RobotPose | None:
        """Return the poses of a telemetry row; None if the model has no solution.

        The control loop reports a missing solution in its state and as an event.
        """
        try:
            self._wrench[:3] = row[self._force]
            near = self._near = self._statics.solve(row[self._joints], self._wrench, self._near)
        except CtrError:
            self._near = None
            return None
        alpha, beta = self._robot.tube_poses(row[self._joints])
        # Behind the plate the guide keeps the tubes straight, so a base is on the line behind the plate.
        starts = self._plate + beta[:, None] * self._forward
        bases = [
            (base, _turned(self._upright, turn)) for base, turn in zip(starts.tolist(), alpha.tolist(), strict=True)
        ]
        plate: Pose = (self._plate.tolist(), self._upright)
        tip: Pose = (near.tip.tolist(), quaternion_of(near.rotation))
        return RobotPose(plate, tip, tuple(bases), tuple(self._lines(near, starts, beta)))

    def _lines(self, solution: Solution, starts: Array, beta: Array) -> list[Array]:
        shape = self._statics.shape(solution)
        arc, points = shape[:, 0], shape[:, 10:13]
        lines: list[Array] = []
        for tube, start, base in zip(self._robot.tubes, starts, beta.tolist(), strict=True):
            sections = int(arc.searchsorted(base + tube.length + 1e-9))
            # Every second section is enough: a chord of 20 mm in a curve of 4/m has an error of at most 0.2 mm.
            lines.append(np.concatenate((start[None], points[: sections - 1 : 2], points[sections - 1, None])))
        return lines


def columns_of(channels: Sequence[Channel], group: str) -> slice:
    """Return the columns of a channel group, or of a single channel that has no group."""
    groups = [channel.name.rpartition(".")[0] or channel.name for channel in channels]
    return slice(groups.index(group), groups.index(group) + groups.count(group))


def quaternion_of(rotation: Array) -> tuple[float, float, float, float]:
    """Return the quaternion x, y, z, w of a rotation matrix (3, 3)."""
    ((a, b, c), (d, e, f), (g, h, i)) = rotation.tolist()
    # The largest of the four components is computed first, so that the divisor of the others is never near zero.
    largest = max((a + e + i, 0), (a, 1), (e, 2), (i, 3))[1]
    if largest == 0:
        four = (h - f, c - g, d - b, 1.0 + a + e + i)
    elif largest == 1:
        four = (1.0 + a - e - i, b + d, c + g, h - f)
    elif largest == 2:
        four = (b + d, 1.0 - a + e - i, f + h, c - g)
    else:
        four = (c + g, f + h, 1.0 - a - e + i, d - b)
    size = math.hypot(*four)
    return four[0] / size, four[1] / size, four[2] / size, four[3] / size


def _turned(quaternion: Sequence[float], angle: float) -> tuple[float, float, float, float]:
    """Return a quaternion after a rotation about its z axis."""
    x, y, z, w = quaternion
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    return c * x + s * y, c * y - s * x, c * z + s * w, c * w - s * z
