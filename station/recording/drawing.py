"""Drawing of the robot for Foxglove: tubes as lines, force at the tip as an arrow, tip positions as poses."""

import math
from collections.abc import Sequence

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
from station.recording.robot_pose import PoseReader, RobotPose, columns_of

#: Length [m/N] and width [m] of the arrow that shows the force.
ARROW_SCALE_M_PER_N, ARROW_WIDTH_M = 0.2, 0.002
#: Smallest force for which an arrow is drawn [N].
MIN_DRAWN_FORCE_N = 0.005
#: Colours of the tubes, innermost tube first. Two digits keep the messages short, because a
#: recording has many of them.
TUBE_COLOURS = tuple(Colour(*(round(part / 255, 2) for part in colour)) for colour in palette.TUBES)
FORCE_COLOUR = Colour(*(round(part / 255, 2) for part in palette.FORCE))
#: Channel group with a tip position, by topic. The true tip exists only in recordings of a virtual lab.
TIP_TOPICS = {
    "/tip/measured": "tip_measured",
    "/tip/estimated": "tip_estimated",
    "/tip/desired": "tip_desired",
    "/tip/true": "tip_true",
}


class Drawing:
    """Creates the drawing messages of one robot from telemetry rows."""

    def __init__(self, robot: Robot, channels: Sequence[Channel], first_topic: int) -> None:
        """Prepare the messages; `first_topic` is the id in the file of the first of `topics`."""
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
        """Return the drawing messages of a telemetry row at `stamp` [ns] with an already computed robot pose."""
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
