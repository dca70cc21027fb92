"""The robot as Foxglove draws it: tubes as lines, the force as an arrow, the tips as poses."""

import math
from collections.abc import Sequence

from core.robot.robot import Array, Robot
from station.config import palette
from station.control.telemetry import Channel
from station.recording.data_section import Said, Topic
from station.recording.foxglove import Colour, FrameTransforms, Line, arrow, json_topic, position_in_frame, scene_update
from station.recording.posed import Posed, Poser, place_of

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
        self._poser = Poser(robot, channels)
        self._frames = FrameTransforms(("plate", "tip", *(f"{tube.name} base" for tube in robot.tubes)))
        self._lines = [Line(tube.outer_diameter, TUBES[i % len(TUBES)]) for i, tube in enumerate(robot.tubes)]
        self._force, self._known = place_of(channels, "force_filtered"), place_of(channels, "truth_known").start
        self._tips = [(number, name, place_of(channels, group)) for number, (name, group) in enumerate(TIPS.items(), 2)]

    def messages(self, row: Array, stamp: int) -> list[Said]:
        """What there is to draw of a row at `stamp` [ns]; without a shape only the tips."""
        return self.posed(row, self._poser.of(row), stamp)

    def posed(self, row: Array, posed: Posed | None, stamp: int) -> list[Said]:
        """The same of a row whose shape is known already."""
        said = [
            Said(self._first + number, stamp, position_in_frame(stamp, row[at].tolist()))
            for number, name, at in self._tips
            if name != "/tip/true" or row[self._known] > 0.0
        ]
        if posed is None:
            return said
        poses = [posed.plate, posed.tip, *posed.bases]
        return [
            Said(self._first, stamp, self._frames.message(stamp, poses)),
            Said(self._first + 1, stamp, self._scene(stamp, posed, row[self._force])),
            *said,
        ]

    def _scene(self, stamp: int, posed: Posed, force: Array) -> bytes:
        lines = [line.through(points) for line, points in zip(self._lines, posed.lines, strict=True)]
        size = math.sqrt(force @ force)
        arrows: list[str] = []
        if size > FORCE_SHOWN:
            turned = _from_x([part / size for part in force.tolist()])
            arrows.append(arrow(posed.tip[0], turned, ARROW_SCALE * size, ARROW_WIDTH, FORCE))
        return scene_update(stamp, "robot", lines, arrows)


def _from_x(direction: Sequence[float]) -> tuple[float, float, float, float]:
    """The shortest turn of the x axis to a unit vector."""
    x, y, z = direction
    if x < -1.0 + 1e-9:
        return 0.0, 0.0, 1.0, 0.0
    size = math.sqrt(2.0 * (1.0 + x))
    return 0.0, -z / size, y / size, 0.5 * size
