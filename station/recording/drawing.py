"""The robot as Foxglove draws it: tubes as lines, the force as an arrow, the tips as poses.

The shape is the loaded model at the measured joints and the filtered force, as in the station's own scene.
"""

import math
from collections.abc import Sequence

import numpy as np

from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config import palette
from station.control.telemetry import Channel
from station.recording.data_section import Said, Topic
from station.recording.foxglove import Colour, FrameTransforms, Line, arrow, json_topic, position_in_frame, scene_update

#: Length of the arrow [m/N] and its width [m].
ARROW_SCALE, ARROW_WIDTH = 0.2, 0.002
#: Below this there is no arrow [N].
FORCE_SHOWN = 0.005
#: Innermost tube first; two digits of a colour are enough in a message that is written over and over.
TUBES = tuple(Colour(*(round(part / 255, 2) for part in colour)) for colour in palette.TUBES)
FORCE = Colour(*(round(part / 255, 2) for part in palette.FORCE))
#: Topic by group of channels. The truth is there only where there is one.
TIPS = {
    "/tip/measured": "tip_measured",
    "/tip/estimated": "tip_estimated",
    "/tip/desired": "tip_desired",
    "/tip/true": "tip_true",
}
Pose = tuple[Sequence[float], Sequence[float]]  #: position [m] and quaternion x, y, z, w


class Drawing:
    """Messages for one robot, from rows with its channels."""

    def __init__(self, robot: Robot, channels: Sequence[Channel], first_topic: int) -> None:
        """Say which id the first of `topics` has in the file."""
        self.topics: tuple[Topic, ...] = (
            json_topic("/tf", "foxglove.FrameTransforms"),
            json_topic("/scene", "foxglove.SceneUpdate"),
            *(json_topic(name, "foxglove.PoseInFrame") for name in TIPS),
        )
        self._first = first_topic
        self._robot, self._statics = robot, Statics(robot)
        self._near: Solution | None = None
        self._wrench = np.zeros(6)
        self._frames = FrameTransforms(("plate", "tip", *(f"{tube.name} base" for tube in robot.tubes)))
        self._lines = [Line(tube.outer_diameter, TUBES[i % len(TUBES)]) for i, tube in enumerate(robot.tubes)]
        rotation = robot.layout.base[:9].reshape(3, 3)
        self._plate, self._forward = np.array(robot.base.position), rotation[:, 2]
        self._upright = quaternion_of(rotation)
        groups = [channel.name.rpartition(".")[0] or channel.name for channel in channels]

        def place(group: str) -> slice:
            return slice(groups.index(group), groups.index(group) + groups.count(group))

        self._joints, self._force, self._known = place("joints"), place("force_filtered"), place("truth_known").start
        self._tips = [(number, name, place(group)) for number, (name, group) in enumerate(TIPS.items(), start=2)]

    def messages(self, row: Array, stamp: int) -> list[Said]:
        """What there is to draw of a row at `stamp` [ns]; without a shape only the tips."""
        said = [
            Said(self._first + number, stamp, position_in_frame(stamp, row[at].tolist()))
            for number, name, at in self._tips
            if name != "/tip/true" or row[self._known] > 0.0
        ]
        try:
            self._wrench[:3] = row[self._force]
            self._near = self._statics.solve(row[self._joints], self._wrench, self._near)
        except CtrError:
            # The loop says in the row's state and in an event that there is no shape.
            self._near = None
            return said
        alpha, beta = self._robot.tube_poses(row[self._joints])
        # The guide holds the tubes straight behind the plate.
        starts = self._plate + beta[:, None] * self._forward
        tip: Pose = (self._near.tip.tolist(), quaternion_of(self._near.rotation))
        bases = [
            (place, _turned(self._upright, turn)) for place, turn in zip(starts.tolist(), alpha.tolist(), strict=True)
        ]
        poses: list[Pose] = [(self._plate.tolist(), self._upright), tip, *bases]
        return [
            Said(self._first, stamp, self._frames.message(stamp, poses)),
            Said(self._first + 1, stamp, self._scene(stamp, self._near, starts, beta, row[self._force])),
            *said,
        ]

    def _scene(self, stamp: int, solution: Solution, starts: Array, beta: Array, force: Array) -> bytes:
        shape = self._statics.shape(solution)
        arc, places = shape[:, 0], shape[:, 10:13]
        lines: list[str] = []
        for tube, line, start, begin in zip(self._robot.tubes, self._lines, starts, beta.tolist(), strict=True):
            sections = int(arc.searchsorted(begin + tube.length + 1e-9))
            # Every second section will do: a chord of 20 mm of a curve of 4/m is 0.2 mm off at most.
            lines.append(
                line.through(np.concatenate((start[None], places[: sections - 1 : 2], places[sections - 1, None])))
            )
        size = math.sqrt(force @ force)
        arrows: list[str] = []
        if size > FORCE_SHOWN:
            turned = _from_x([part / size for part in force.tolist()])
            arrows.append(arrow(solution.tip.tolist(), turned, ARROW_SCALE * size, ARROW_WIDTH, FORCE))
        return scene_update(stamp, "robot", lines, arrows)


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


def _from_x(direction: Sequence[float]) -> tuple[float, float, float, float]:
    """The shortest turn of the x axis to a unit vector."""
    x, y, z = direction
    if x < -1.0 + 1e-9:
        return 0.0, 0.0, 1.0, 0.0
    size = math.sqrt(2.0 * (1.0 + x))
    return 0.0, -z / size, y / size, 0.5 * size
