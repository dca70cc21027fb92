"""Messages that Foxglove shows, as JSON of its well-known schemas: poses, frames, lines, arrows and log events."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from core.robot.robot import Array
from station.recording.data_section import Topic

#: Name of the coordinate frame in which everything is drawn.
WORLD = "world"
#: Topic of the events of a run: state changes, faults, commands. The log panel of Foxglove lists them.
EVENTS_TOPIC = "/events"
EVENTS_SCHEMA = "foxglove.Log"
#: Severity levels of the message type foxglove.Log.
INFO, WARNING, ERROR, FATAL = 2, 3, 4, 5


class Colour(NamedTuple):
    """Colour with components from 0 to 1."""

    red: float
    green: float
    blue: float
    alpha: float = 1.0


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER, _WHOLE, _TEXT, _TRUTH = {"type": "number"}, {"type": "integer"}, {"type": "string"}, {"type": "boolean"}
_TIME = _object(sec=_WHOLE, nsec=_WHOLE)
_POINT = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object(position=_POINT, orientation=_QUATERNION)
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE = _object(
    type=_WHOLE, pose=_POSE, thickness=_NUMBER, scale_invariant=_TRUTH, points=_list(_POINT), color=_COLOUR,
    colors=_list(_COLOUR), indices=_list(_WHOLE),
)  # fmt: skip
_ARROW = _object(
    pose=_POSE, shaft_length=_NUMBER, shaft_diameter=_NUMBER, head_length=_NUMBER, head_diameter=_NUMBER, color=_COLOUR
)
_ENTITY = _object(
    timestamp=_TIME, frame_id=_TEXT, id=_TEXT, lifetime=_TIME, frame_locked=_TRUTH,
    metadata=_list(_object(key=_TEXT, value=_TEXT)), arrows=_list(_ARROW), lines=_list(_LINE),
    **{kind: _list({"type": "object"}) for kind in ("cubes", "spheres", "cylinders", "triangles", "texts", "models")},
)  # fmt: skip
_SCHEMAS = {
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.FrameTransforms": _object(
        transforms=_list(
            _object(
                timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_POINT, rotation=_QUATERNION
            )
        )
    ),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=_WHOLE, id=_TEXT)), entities=_list(_ENTITY)
    ),
    "foxglove.Log": _object(
        timestamp=_TIME,
        level=_WHOLE,
        message=_TEXT,
        name=_TEXT,
        file=_TEXT,
        line=_WHOLE,
        time={"type": "number", "description": "time on the clock of /telemetry [s]"},
        data={"type": "object"},
    ),
}


def json_topic(name: str, schema: str) -> Topic:
    """Return an MCAP topic whose JSON messages have one of the well-known schemas of Foxglove."""
    return Topic(name, "json", schema, "jsonschema", json.dumps({"title": schema, **_SCHEMAS[schema]}))


# The messages are templates with `%`. Filling a template takes a third of the time that building the same JSON from
# objects takes, and a process that draws 25 times a second must not slow down the control loop.
_STAMP = '{"sec":%d,"nsec":%d}'
_XYZ = '{"x":%.6f,"y":%.6f,"z":%.6f}'
_XYZW = '{"x":%.7f,"y":%.7f,"z":%.7f,"w":%.7f}'
_UPRIGHT = '{"x":0,"y":0,"z":0,"w":1}'
_TIP = f'{{"timestamp":{_STAMP},"frame_id":"{WORLD}","pose":{{"position":{_XYZ},"orientation":{_UPRIGHT}}}}}'
_ARROWS = (
    f'{{"pose":{{"position":{_XYZ},"orientation":{_XYZW}}},"shaft_length":%.6f,"shaft_diameter":%.6f,'
    '"head_length":%.6f,"head_diameter":%.6f,"color":%s}'
)
_SCENE = (
    f'{{"deletions":[],"entities":[{{"timestamp":{_STAMP},"frame_id":"{WORLD}","id":"%s",'
    '"lifetime":{"sec":0,"nsec":0},"frame_locked":false,"metadata":[],"arrows":[%s],"cubes":[],"spheres":[],'
    '"cylinders":[],"lines":[%s],"triangles":[],"texts":[],"models":[]}]}'
)


def position_in_frame(stamp: int, position: Sequence[float]) -> bytes:
    """Return a foxglove.PoseInFrame of a point (3) [m] without orientation, at `stamp` [ns]."""
    return (_TIP % (*divmod(stamp, 10**9), *position)).encode()


class FrameTransforms:
    """Template of a foxglove.FrameTransforms message for a fixed list of frames."""

    def __init__(self, names: Sequence[str]) -> None:
        self._template = ",".join(
            f'{{"timestamp":{_STAMP},"parent_frame_id":"{WORLD}","child_frame_id":{_literal(name)},'
            f'"translation":{_XYZ},"rotation":{_XYZW}}}'
            for name in names
        )

    def message(self, stamp: int, poses: Sequence[tuple[Sequence[float], Sequence[float]]]) -> bytes:
        """Return the message for the pose of each frame in the world: position [m] and quaternion x, y, z, w."""
        time = divmod(stamp, 10**9)
        numbers = tuple(number for position, turn in poses for number in (*time, *position, *turn))
        return f'{{"transforms":[{self._template % numbers}]}}'.encode()


class LineStrip:
    """Template of a foxglove.LinePrimitive with one colour and thickness."""

    def __init__(self, thickness: float, colour: Colour) -> None:
        """Create the template of a polyline with this thickness [m]."""
        self._before = (
            f'{{"type":0,"pose":{{"position":{{"x":0,"y":0,"z":0}},"orientation":{_UPRIGHT}}},'
            f'"thickness":{thickness:.6f},"scale_invariant":false,"points":['
        )
        self._after = f'],"color":{_colour(colour)},"colors":[],"indices":[]}}'

    def through(self, points: Array) -> str:
        """Return the polyline through points (n, 3) [m]."""
        return f"{self._before}{_corners(len(points)) % tuple(points.ravel().tolist())}{self._after}"


def arrow(position: Sequence[float], quaternion: Sequence[float], length: float, width: float, colour: Colour) -> str:
    """Return a foxglove.ArrowPrimitive of a length [m] along the x axis rotated by the quaternion."""
    sizes = (0.8 * length, width, 0.2 * length, 2.0 * width)
    return _ARROWS % (*position, *quaternion, *sizes, _colour(colour))


def scene_update(stamp: int, entity: str, lines: Sequence[str], arrows: Sequence[str]) -> bytes:
    """Return a foxglove.SceneUpdate with one entity, which replaces its previous state."""
    return (_SCENE % (*divmod(stamp, 10**9), entity, ",".join(arrows), ",".join(lines))).encode()


@cache
def _corners(count: int) -> str:
    return ",".join((_XYZ,) * count)


def _colour(colour: Colour) -> str:
    return f'{{"r":{colour.red:g},"g":{colour.green:g},"b":{colour.blue:g},"a":{colour.alpha:g}}}'


def _literal(name: str) -> str:
    """Return a name as JSON that can be part of a template: percent signs are doubled."""
    return json.dumps(name).replace("%", "%%")


#: Kind of an event by which an operator marks a moment of a run.
MARK = "mark"


class RecordedEvent(NamedTuple):
    """Event of a run: a change of state, a fault, a command, ..."""

    time: float  #: time of the event, on the same clock as the channel `time` [s]
    kind: str  #: state, command, fault, mark, ...
    text: str  #: human-readable text
    level: int = INFO
    data: Mapping[str, Any] = {}  #: machine-readable JSON values


def event_json(event: RecordedEvent, stamp: int) -> bytes:
    """Return an event as the JSON of a foxglove.Log message at `stamp` [ns]."""
    message = {
        "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9},
        "level": event.level,
        "message": event.text,
        "name": event.kind,
        "file": "",
        "line": 0,
        "time": event.time,
        "data": dict(event.data),
    }
    return json.dumps(message, allow_nan=False).encode()


def event_of(message: Mapping[str, Any]) -> RecordedEvent:
    """Return the event from the JSON object of a message that `event_json` has created."""
    return RecordedEvent(message["time"], message["name"], message["message"], message["level"], message["data"])
