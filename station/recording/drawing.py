"""Drawing of the robot for Foxglove: tubes as lines, force at the tip as an arrow, tip positions as poses.

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
from station.config import palette
from station.control.telemetry import Channel
from station.recording.data_section import Topic, WrittenMessage
from station.recording.foxglove import (
    Colour,
    FrameTransforms,
    LineStrip,
    arrow,
    json_topic,
    position_in_frame,
    scene_update,
)

Pose = tuple[Sequence[float], Sequence[float]]  #: pose as position [m] and quaternion x, y, z, w
#: Length [m/N] and width [m] of the arrow that shows the force.
ARROW_SCALE_M_PER_N, ARROW_WIDTH_M = 0.2, 0.002
#: Smallest force for which an arrow is drawn [N].
MIN_DRAWN_FORCE_N = 0.005
#: Colours of the tubes, innermost tube first; two digits keep the many messages of a recording short.
TUBE_COLOURS = tuple(Colour(*(round(part / 255, 2) for part in colour)) for colour in palette.TUBES)
FORCE_COLOUR = Colour(*(round(part / 255, 2) for part in palette.FORCE))
#: Channel group with a tip position, by topic. The true tip exists only in recordings of a virtual lab.
TIP_TOPICS = {
    "/tip/measured": "tip_measured",
    "/tip/estimated": "tip_estimated",
    "/tip/desired": "tip_desired",
    "/tip/true": "tip_true",
}


class RobotPose(NamedTuple):
    """Poses and centre lines of the robot's parts in the world frame."""

    plate: Pose
    tip: Pose  #: pose of the tip that the model computes
    bases: tuple[Pose, ...]  #: pose of each tube's base, which rotates with the tube
    lines: tuple[Array, ...]  #: centre line of each tube, from its base to its end (k, 3) [m]
    jacobian: Array  #: (6, n) derivative of the tip's position [m] and rotation [rad] by the joints [rad or m]


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
        return RobotPose(plate, tip, tuple(bases), tuple(self._lines(near, starts, beta)), near.jacobian)

    def _lines(self, solution: Solution, starts: Array, beta: Array) -> list[Array]:
        shape = self._statics.shape(solution)
        arc, points = shape[:, 0], shape[:, 10:13]
        lines: list[Array] = []
        for tube, start, base in zip(self._robot.tubes, starts, beta.tolist(), strict=True):
            sections = max(int(arc.searchsorted(base + tube.length + 1e-9)), 1)
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


def rotation_of(quaternion: Sequence[float]) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ])  # fmt: skip


def _turned(quaternion: Sequence[float], angle: float) -> tuple[float, float, float, float]:
    """Return a quaternion after a rotation about its z axis."""
    x, y, z, w = quaternion
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    return c * x + s * y, c * y - s * x, c * z + s * w, c * w - s * z


class Drawing:
    """Creates the drawing messages of one robot from telemetry rows."""

    def __init__(self, robot: Robot, channels: Sequence[Channel], first_topic: int) -> None:
        """Prepare the messages; `first_topic` is the MCAP id of the first of `topics`."""
        self.topics: tuple[Topic, ...] = (
            json_topic("/tf", "foxglove.FrameTransforms"),
            json_topic("/scene", "foxglove.SceneUpdate"),
            *(json_topic(name, "foxglove.PoseInFrame") for name in TIP_TOPICS),
        )
        self._first = first_topic
        self._poser = PoseReader(robot, channels)
        self._frames = FrameTransforms(("plate", "tip", *(f"{tube.name} base" for tube in robot.tubes)))
        self._lines = [
            LineStrip(tube.outer_diameter, TUBE_COLOURS[i % len(TUBE_COLOURS)]) for i, tube in enumerate(robot.tubes)
        ]
        self._force, self._known = columns_of(channels, "force_filtered"), columns_of(channels, "truth_known").start
        self._tips = [
            (number, name, columns_of(channels, group)) for number, (name, group) in enumerate(TIP_TOPICS.items(), 2)
        ]

    def messages(self, row: Array, stamp: int) -> list[WrittenMessage]:
        """Return the drawing messages of a telemetry row at `stamp` [ns].

        If the model has no solution, only the messages of the tip positions are returned.
        """
        return self.posed(row, self._poser.of(row), stamp)

    def posed(self, row: Array, posed: RobotPose | None, stamp: int) -> list[WrittenMessage]:
        """Return the drawing messages of a telemetry row at `stamp` [ns] for its robot pose, computed by the caller."""
        said = [
            WrittenMessage(self._first + number, stamp, position_in_frame(stamp, row[at].tolist()))
            for number, name, at in self._tips
            if name != "/tip/true" or row[self._known] > 0.0
        ]
        if posed is None:
            return said
        poses = [posed.plate, posed.tip, *posed.bases]
        return [
            WrittenMessage(self._first, stamp, self._frames.message(stamp, poses)),
            WrittenMessage(self._first + 1, stamp, self._scene(stamp, posed, row[self._force])),
            *said,
        ]

    def _scene(self, stamp: int, posed: RobotPose, force: Array) -> bytes:
        lines = [line.through(points) for line, points in zip(self._lines, posed.lines, strict=True)]
        size = math.sqrt(force @ force)
        arrows: list[str] = []
        if size > MIN_DRAWN_FORCE_N:
            turned = _from_x([part / size for part in force.tolist()])
            arrows.append(arrow(posed.tip[0], turned, ARROW_SCALE_M_PER_N * size, ARROW_WIDTH_M, FORCE_COLOUR))
        return scene_update(stamp, "robot", lines, arrows)


def _from_x(direction: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the shortest rotation of the x axis to a unit vector, as a quaternion x, y, z, w."""
    x, y, z = direction
    if x < -1.0 + 1e-9:
        return 0.0, 0.0, 1.0, 0.0
    size = math.sqrt(2.0 * (1.0 + x))
    return 0.0, -z / size, y / size, 0.5 * size
