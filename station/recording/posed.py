"""The robot in the world as one row of telemetry has it: plate, tip, the tubes' bases and their centre lines.

The shape is the loaded model at the measured joints and the filtered force, as in the station's own scene.
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

Pose = tuple[Sequence[float], Sequence[float]]  #: position [m] and quaternion x, y, z, w


class Posed(NamedTuple):
    """In the world."""

    plate: Pose
    tip: Pose  #: of the model
    bases: tuple[Pose, ...]  #: of each tube, turned with it
    lines: tuple[Array, ...]  #: centre line of each tube, from its base to its end (k, 3) [m]


class Poser:
    """Of one robot, from rows with its channels."""

    def __init__(self, robot: Robot, channels: Sequence[Channel]) -> None:
        self._robot, self._statics = robot, Statics(robot)
        self._near: Solution | None = None
        self._wrench = np.zeros(6)
        rotation = robot.layout.base[:9].reshape(3, 3)
        self._plate, self._forward = np.array(robot.base.position), rotation[:, 2]
        self._upright = quaternion_of(rotation)
        self._joints, self._force = place_of(channels, "joints"), place_of(channels, "force_filtered")

    def of(self, row: Array) -> Posed | None:
        """None where the model has no shape: the loop says in the row's state and in an event that there is none."""
        try:
            self._wrench[:3] = row[self._force]
            near = self._near = self._statics.solve(row[self._joints], self._wrench, self._near)
        except CtrError:
            self._near = None
            return None
        alpha, beta = self._robot.tube_poses(row[self._joints])
        # The guide holds the tubes straight behind the plate.
        starts = self._plate + beta[:, None] * self._forward
        bases = [
            (place, _turned(self._upright, turn)) for place, turn in zip(starts.tolist(), alpha.tolist(), strict=True)
        ]
        plate: Pose = (self._plate.tolist(), self._upright)
        tip: Pose = (near.tip.tolist(), quaternion_of(near.rotation))
        return Posed(plate, tip, tuple(bases), tuple(self._lines(near, starts, beta)))

    def _lines(self, solution: Solution, starts: Array, beta: Array) -> list[Array]:
        shape = self._statics.shape(solution)
        arc, places = shape[:, 0], shape[:, 10:13]
        lines: list[Array] = []
        for tube, start, begin in zip(self._robot.tubes, starts, beta.tolist(), strict=True):
            sections = int(arc.searchsorted(begin + tube.length + 1e-9))
            # Every second section will do: a chord of 20 mm of a curve of 4/m is 0.2 mm off at most.
            lines.append(np.concatenate((start[None], places[: sections - 1 : 2], places[sections - 1, None])))
        return lines


def place_of(channels: Sequence[Channel], group: str) -> slice:
    """Columns of a group, or of one channel that is in none."""
    groups = [channel.name.rpartition(".")[0] or channel.name for channel in channels]
    return slice(groups.index(group), groups.index(group) + groups.count(group))


def quaternion_of(rotation: Array) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation matrix (3, 3)."""
    ((a, b, c), (d, e, f), (g, h, i)) = rotation.tolist()
    # From the largest of the four, so that nothing is divided by what may vanish.
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
    """A quaternion after a turn about its own z axis."""
    x, y, z, w = quaternion
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    return c * x + s * y, c * y - s * x, c * z + s * w, c * w - s * z
