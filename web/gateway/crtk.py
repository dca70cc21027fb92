"""CRTK, the interface of the collaborative robotics toolkit: content of each published topic and received command.

`OUTPUTS` and `INPUTS` have each name once, with its ROS 2 type. Values are those of telemetry, in SI units and in the
frame `world`; a value that is unknown now is sent with the stamp 0.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from core.robot.robot import Array, Robot
from station.config import palette
from station.control.states import State
from station.control.telemetry import Channels, stale_groups
from station.recording.drawing import Pose, quaternion_of, rotation_of
from web.gateway import ros_types as ros
from web.gateway.cdr import BadMessage, blank, layout_of
from web.gateway.ros_types import DEFINITIONS, RosType
from web.gateway.snapshot import SceneState, StationInfo

#: Names of frames: the world, the robot's front plate, and an unrotated frame at the tip for the force that acts there.
WORLD, PLATE, LOAD = "world", "plate", "tip_load"
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
#: Type of a line in a Marker message, and the fields of a marker; action 0 adds or replaces it.
LINE_STRIP = 4
_MARKER_LAYOUT = layout_of("Marker", DEFINITIONS)
_MARKER = {part.name: value for part, value in zip(_MARKER_LAYOUT, blank(_MARKER_LAYOUT), strict=True)}
#: States of CRTK. DISABLED: no motion is possible before the station is connected and homed.
OPERATING_STATES = {
    State.OFF: "DISABLED", State.CONNECTING: "DISABLED", State.CONNECTED: "DISABLED",
    State.HOMING: "ENABLED", State.HOMED: "ENABLED", State.READY: "ENABLED", State.RUNNING: "ENABLED",
    State.HOLD: "PAUSED", State.STOPPED: "PAUSED", State.FAULT: "FAULT",
}  # fmt: skip
#: States in which the positions of all joints are known. A FAULT may have lost them.
HOMED_STATES = (State.HOMED, State.READY, State.RUNNING, State.HOLD, State.STOPPED)


class Sample:
    """Telemetry row whose values are encoded."""

    def __init__(self, robot: Robot, channels: Channels, scene: SceneState) -> None:
        self.robot, self.scene = robot, scene
        self._channels, self._stale = channels, stale_groups(channels, scene.row)

    def of(self, field: str) -> list[float] | None:
        """Return a field of telemetry; None: its value is stale or was never known."""
        return None if field in self._stale else self._channels.of(self.scene.row, field).tolist()

    def joints(self, velocity: str) -> tuple[Any, ...]:
        """Return names, positions, and a field of velocities; the stages measure no efforts."""
        return self.robot.joint_names, self.of("joints") or (), self.of(velocity) or (), ()

    def pose(self, position: str, direction: str) -> Pose | None:
        """Return a tip pose from two fields; without the direction, the orientation is that of the model's tip."""
        place, axis, model = self.of(position), self.of(direction), self.scene.pose
        if place is None:
            return None
        return place, _along(axis) if axis else _UPRIGHT if model is None else model.tip[1]

    @property
    def goal(self) -> Pose | None:
        """Goal of the streamed motion; None without one."""
        kind = self.of("request_kind")
        return self.pose("request", "direction_desired") if kind == [1.0] else None

    @property
    def tip_in_plate(self) -> Pose | None:
        """Pose of the model's tip in the frame of the front plate."""
        if (pose := self.scene.pose) is None:
            return None
        plate, tip = rotation_of(pose.plate[1]), rotation_of(pose.tip[1])
        offset = np.subtract(pose.tip[0], pose.plate[0])
        return (plate.T @ offset).tolist(), quaternion_of(plate.T @ tip)

    @property
    def load(self) -> tuple[Sequence[float], Sequence[float]] | None:
        """Force [N] and moment [N m] at the tip."""
        force, moment, pose = self.of("force"), self.of("moment"), self.scene.pose
        if force is None or moment is None or pose is None:
            return None
        # The measured moment, converted from the plate's origin to the tip; only noise if the load acts at the tip.
        return force, (np.array(moment) - np.cross(np.subtract(pose.tip[0], pose.plate[0]), force)).tolist()

    @property
    def velocity(self) -> tuple[list[float], tuple[float, ...]] | None:
        """Observed velocity of the tip [m/s]; its angular velocity is not observed."""
        linear = self.of("velocity_observed")
        return None if linear is None else (linear, (0.0, 0.0, 0.0))

    @property
    def jacobian(self) -> tuple[Any, ...] | None:
        """Derivative of the tip's position and rotation by the joints, as layout and data."""
        if self.scene.pose is None:
            return None
        matrix = self.scene.pose.jacobian
        rows, columns = matrix.shape
        return ((("rows", rows, rows * columns), ("columns", columns, columns)), 0), matrix.ravel()

    @property
    def frames(self) -> tuple[Any, ...]:
        """Poses of all frames in the world."""
        pose = self.scene.pose
        if pose is None:
            return ((),)
        named = [(PLATE, pose.plate), ("tip", pose.tip), (LOAD, (pose.tip[0], _UPRIGHT))]
        named += [(f"{tube.name}_base", base) for tube, base in zip(self.robot.tubes, pose.bases, strict=True)]
        return (tuple((_header(self.scene.stamp, WORLD), name, place) for name, place in named),)

    @property
    def tubes(self) -> tuple[Any, ...]:
        """Centre line of each tube as a line of the tube's width."""
        markers = list[tuple[Any, ...]]()
        for number, (tube, points) in enumerate(zip(self.robot.tubes, self.scene.lines, strict=False)):
            fields = _MARKER | {
                "header": _header(self.scene.stamp, WORLD), "ns": "tubes", "id": number, "type": LINE_STRIP,
                "pose": ((0.0, 0.0, 0.0), _UPRIGHT), "scale": (tube.outer_diameter, 0.0, 0.0),
                "color": (*(part / 255 for part in palette.tube(number)), 1.0), "points": points,
            }  # fmt: skip
            markers.append(tuple(fields.values()))
        return (tuple(markers),)


class Output(NamedTuple):
    """A published topic."""

    kind: RosType
    frame: str = ""  #: frame in the header; empty: the type has no header
    value: Callable[[Sample], Any] | None = None  #: returns the fields after the header, None if they are unknown now
    latched: bool = False  #: whether later subscribers receive the last message (transient local)


#: Published topics below the robot's namespace; the name of `/tf` is the same for all robots.
OUTPUTS = {
    "measured_js": Output(ros.JOINT_STATE, WORLD, lambda at: at.joints("velocity_sent")),
    "setpoint_js": Output(ros.JOINT_STATE, WORLD, lambda at: at.joints("velocity_commanded")),
    "measured_cp": Output(ros.POSE, WORLD, lambda at: at.scene.pose and (at.scene.pose.tip,)),
    "measured2_cp": Output(ros.POSE, WORLD, lambda at: _one(at.pose("tip_measured", "direction_measured"))),
    "setpoint_cp": Output(ros.POSE, WORLD, lambda at: _one(at.pose("tip_desired", "direction_desired"))),
    "goal_cp": Output(ros.POSE, WORLD, lambda at: _one(at.goal)),
    "local/measured_cp": Output(ros.POSE, PLATE, lambda at: _one(at.tip_in_plate)),
    "measured_cv": Output(ros.TWIST, WORLD, lambda at: _one(at.velocity)),
    "measured_cf": Output(ros.WRENCH, LOAD, lambda at: _one(at.load)),
    "jacobian": Output(ros.MATRIX, "", lambda at: at.jacobian),
    "tubes": Output(ros.MARKERS, "", lambda at: at.tubes),
    "/tf": Output(ros.TRANSFORMS, "", lambda at: at.frames),
    "operating_state": Output(ros.STATE, WORLD, latched=True),
    "error": Output(ros.STRING),
    "warning": Output(ros.STRING),
    "status": Output(ros.STRING),
}


def message(output: Output, at: Sample) -> bytes:
    """Return the message of a topic for one telemetry row."""
    value, kind = output.value and output.value(at), output.kind
    if value is None:
        value = blank(kind.layout)
        return kind.encode(*((_header(0, output.frame), *value[1:]) if output.frame else value))
    return kind.encode(_header(at.scene.stamp, output.frame), *value) if output.frame else kind.encode(*value)


def operating_state(info: StationInfo, busy: bool, stamp: int) -> tuple[Any, ...]:
    """Return the OperatingState of the station; `busy`: a homing, or a motion to a goal, has not ended yet."""
    state = info.state
    busy = busy or state is State.HOMING
    return _header(stamp, WORLD), OPERATING_STATES[state], state in HOMED_STATES, busy


class Content(NamedTuple):
    """Checked content of a received command."""

    values: tuple[float, ...] = ()  #: position or velocity of the tip or of the joints, SI units
    direction: tuple[float, ...] | None = None  #: direction of the tip in the world, unit vector
    text: str = ""


class Input(NamedTuple):
    """A command that the gateway receives."""

    kind: RosType
    parse: Callable[[Robot, tuple[Any, ...]], Content]  #: raises BadMessage
    latched: bool = False  #: whether its publishers are transient local


def _place(robot: Robot, value: tuple[Any, ...]) -> Content:  # noqa: ARG001 - one type of function
    position, quaternion = value[1]
    _check_frame(value[0])
    return Content(finite("position", position), tuple(direction_of(quaternion).tolist()))


def _step(robot: Robot, value: tuple[Any, ...]) -> Content:
    return _place(robot, value)._replace(direction=None)


def _velocity(robot: Robot, value: tuple[Any, ...]) -> Content:  # noqa: ARG001 - one type of function
    _check_frame(value[0])
    return Content(finite("velocity", value[1][0]))


def _joints(index: int) -> Callable[[Robot, tuple[Any, ...]], Content]:
    def parse(robot: Robot, value: tuple[Any, ...]) -> Content:
        names, numbers, known = value[1], value[index], robot.joint_names
        if len(numbers) != len(known) or (names and sorted(names) != sorted(known)):
            raise BadMessage(f"{len(numbers)} numbers for the joints {names[:20]}; send one for {', '.join(known)}")
        given = dict(zip(names or known, finite("joints", numbers), strict=True))
        return Content(tuple(given[name] for name in known))

    return parse


#: Commands below the robot's namespace.
INPUTS = {
    **dict.fromkeys(("servo_cp", "interpolate_cp", "move_cp"), Input(ros.POSE, _place)),
    **dict.fromkeys(("servo_cr", "move_cr"), Input(ros.POSE, _step)),
    "servo_cv": Input(ros.TWIST, _velocity),
    **dict.fromkeys(
        ("servo_jp", "servo_jr", "interpolate_jp", "move_jp", "move_jr"), Input(ros.JOINT_STATE, _joints(2))
    ),
    "servo_jv": Input(ros.JOINT_STATE, _joints(3)),
    "hold": Input(ros.EMPTY, lambda robot, value: Content()),  # noqa: ARG005 - one type of function
    "state_command": Input(ros.COMMAND, lambda robot, value: Content(text=value[1][:40]), latched=True),  # noqa: ARG005
}  # fmt: skip


def direction_of(quaternion: Sequence[float]) -> Array:
    """Return the z axis (3,) of an orientation; raise BadMessage if it is no unit quaternion."""
    length = math.hypot(*finite("orientation", quaternion))
    if not 0.5 < length < 2.0:
        raise BadMessage(f"the orientation {list(quaternion)} is no unit quaternion")
    return rotation_of([part / length for part in quaternion])[:, 2]


def _one(value: Any) -> tuple[Any] | None:
    return None if value is None else (value,)


def _header(stamp: int, frame: str) -> tuple[tuple[int, int], str]:
    """Return a std_msgs/Header with a time [ns] since 1970."""
    return divmod(stamp, 10**9), frame


def _check_frame(header: tuple[Any, ...]) -> None:
    if header[1] not in ("", WORLD):
        raise BadMessage(f"the frame {header[1][:40]!r} is unknown; send '{WORLD}' or an empty text")


def finite(what: str, numbers: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers; raise BadMessage, which names `what`, if one is not finite."""
    if not all(map(math.isfinite, numbers)):
        raise BadMessage(f"{what}: {list(numbers)} are not all finite")
    return tuple(numbers)


def _along(axis: Sequence[float]) -> tuple[float, ...]:
    """Return the quaternion of the shortest rotation from z to a unit vector."""
    x, y, z = axis
    four = (-y, x, 0.0, 1.0 + z) if z > -1.0 + 1e-9 else (1.0, 0.0, 0.0, 0.0)
    length = math.hypot(*four)
    return tuple(part / length for part in four)
