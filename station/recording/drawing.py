"""The robot as Foxglove draws it: tubes as lines, the force as an arrow, the tips as poses.

The shape is the loaded model at the measured joints and the filtered force, as in the station's own scene.
"""

import math
from collections.abc import Sequence

import numpy as np

from core.errors import CtrError
from core.robot import Array, Robot
from core.solution import Solution
from core.statics import Statics
from station.recording.data_section import Said, Topic
from station.recording.foxglove import (
    Colour,
    arrow,
    frame_transforms,
    json_topic,
    line,
    pose_in_frame,
    scene_update,
)
from station.telemetry import Channel

#: Length of the arrow [m/N] and its width [m].
ARROW_SCALE, ARROW_WIDTH = 0.2, 0.002
#: Below this there is no arrow [N].
FORCE_SHOWN = 0.005
#: Colours that stay apart for colour-blind eyes (Okabe and Ito), innermost tube first.
TUBES = (Colour(0.34, 0.71, 0.91), Colour(0.34, 0.38, 0.44), Colour(0.94, 0.89, 0.26), Colour(0.0, 0.0, 0.0))
FORCE = Colour(0.80, 0.47, 0.65)
#: Topic by group of channels. The truth is there only where there is one.
TIPS = {
    "/tip/measured": "tip_measured",
    "/tip/estimated": "tip_estimated",
    "/tip/desired": "tip_desired",
    "/tip/true": "tip_true",
}
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


Frame = tuple[str, Sequence[float], Sequence[float]]  #: name, position [m], quaternion


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
        rotation = robot.layout.base[:9].reshape(3, 3)
        self._plate, self._forward = list(robot.base.position), rotation[:, 2].tolist()
        self._upright = quaternion_of(rotation)
        groups = [channel.name.rpartition(".")[0] or channel.name for channel in channels]

        def place(group: str) -> slice:
            return slice(groups.index(group), groups.index(group) + groups.count(group))

        self._joints, self._force, self._known = place("joints"), place("force_filtered"), place("truth_known").start
        self._tips = [(number, name, place(group)) for number, (name, group) in enumerate(TIPS.items(), start=2)]

    def messages(self, row: Array, stamp: int) -> list[Said]:
        """What there is to draw of a row at `stamp` [ns]; without a shape only the tips."""
        said = [
            Said(self._first + number, stamp, pose_in_frame(stamp, row[at].tolist(), _UPRIGHT))
            for number, name, at in self._tips
            if name != "/tip/true" or row[self._known] > 0.0
        ]
        try:
            self._near = self._statics.solve(row[self._joints], np.append(row[self._force], np.zeros(3)), self._near)
        except CtrError:
            # The loop says in the row's state and in an event that there is no shape.
            self._near = None
            return said
        shape = self._statics.shape(self._near)
        alpha, beta = self._robot.tube_poses(row[self._joints])
        return [
            Said(self._first, stamp, frame_transforms(stamp, self._frames(self._near, alpha, beta))),
            Said(self._first + 1, stamp, self._scene(stamp, shape, beta, row[self._force])),
            *said,
        ]

    def _frames(self, solution: Solution, alpha: Array, beta: Array) -> list[Frame]:
        frames: list[Frame] = [
            ("plate", self._plate, self._upright),
            ("tip", solution.tip.tolist(), quaternion_of(solution.rotation)),
        ]
        for tube, angle, start in zip(self._robot.tubes, alpha.tolist(), beta.tolist(), strict=True):
            place = [origin + start * axis for origin, axis in zip(self._plate, self._forward, strict=True)]
            frames.append((f"{tube.name} base", place, _turned(self._upright, angle)))
        return frames

    def _scene(self, stamp: int, shape: Array, beta: Array, force: Array) -> bytes:
        lines: list[str] = []
        for number, tube in enumerate(self._robot.tubes):
            start = float(beta[number])
            sections = int(np.searchsorted(shape[:, 0], start + tube.length + 1e-9))
            # The guide holds the tube straight behind the plate.
            behind = [origin + start * axis for origin, axis in zip(self._plate, self._forward, strict=True)]
            lines.append(line(behind, shape[:sections, 10:13], tube.outer_diameter, TUBES[number % len(TUBES)]))
        size = math.sqrt(force @ force)
        arrows: list[str] = []
        if size > FORCE_SHOWN:
            arrows.append(
                arrow(shape[-1, 10:13].tolist(), _from_x(force / size), ARROW_SCALE * size, ARROW_WIDTH, FORCE)
            )
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


def _from_x(direction: Array) -> tuple[float, float, float, float]:
    """The shortest turn of the x axis to a unit vector."""
    x, y, z = direction.tolist()
    if x < -1.0 + 1e-9:
        return 0.0, 0.0, 1.0, 0.0
    size = math.sqrt(2.0 * (1.0 + x))
    return 0.0, -z / size, y / size, 0.5 * size
