"""Messages that Foxglove draws by itself: poses, frames and lines, as JSON of its well-known schemas."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from core.robot import Array
from station.recording.data_section import Topic

#: The frame that everything is drawn in.
WORLD = "world"


class Colour(NamedTuple):
    """0 ... 1."""

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
        time={"type": "number", "description": "as /telemetry has it [s]"},
        data={"type": "object"},
    ),
}


def json_topic(name: str, schema: str) -> Topic:
    """A topic of one of the well-known kinds."""
    return Topic(name, "json", schema, "jsonschema", json.dumps({"title": schema, **_SCHEMAS[schema]}))


def pose_in_frame(stamp: int, position: Sequence[float], quaternion: Sequence[float]) -> bytes:
    """foxglove.PoseInFrame; quaternion x, y, z, w."""
    return f'{{"timestamp":{_time(stamp)},"frame_id":"{WORLD}","pose":{_pose(position, quaternion)}}}'.encode()


def frame_transforms(stamp: int, frames: Sequence[tuple[str, Sequence[float], Sequence[float]]]) -> bytes:
    """foxglove.FrameTransforms of frames in the world: name, position [m], quaternion."""
    time = _time(stamp)
    listed = ",".join(
        f'{{"timestamp":{time},"parent_frame_id":"{WORLD}","child_frame_id":{json.dumps(name)},'
        f'"translation":{_point(position)},"rotation":{_quaternion(quaternion)}}}'
        for name, position, quaternion in frames
    )
    return f'{{"transforms":[{listed}]}}'.encode()


def line(start: Sequence[float], points: Array, thickness: float, colour: Colour) -> str:
    """A foxglove.LinePrimitive from `start` through points (n, 3) [m]."""
    corners = ",".join(('{"x":%.6f,"y":%.6f,"z":%.6f}',) * (len(points) + 1)) % (*start, *points.ravel().tolist())
    return (
        f'{{"type":0,"pose":{_HERE},"thickness":{thickness:.6g},"scale_invariant":false,"points":[{corners}],'
        f'"color":{_colour(colour)},"colors":[],"indices":[]}}'
    )


def arrow(position: Sequence[float], quaternion: Sequence[float], length: float, width: float, colour: Colour) -> str:
    """A foxglove.ArrowPrimitive of a length [m] along the x axis that the quaternion turns."""
    return (
        f'{{"pose":{_pose(position, quaternion)},"shaft_length":{0.8 * length:.6g},"shaft_diameter":{width:.6g},'
        f'"head_length":{0.2 * length:.6g},"head_diameter":{2.0 * width:.6g},"color":{_colour(colour)}}}'
    )


def scene_update(stamp: int, entity: str, lines: Sequence[str], arrows: Sequence[str]) -> bytes:
    """foxglove.SceneUpdate with one entity, which replaces what it was before."""
    return (
        f'{{"deletions":[],"entities":[{{"timestamp":{_time(stamp)},"frame_id":"{WORLD}","id":{json.dumps(entity)},'
        f'"lifetime":{_time(0)},"frame_locked":false,"metadata":[],"arrows":[{",".join(arrows)}],"cubes":[],'
        f'"spheres":[],"cylinders":[],"lines":[{",".join(lines)}],"triangles":[],"texts":[],"models":[]}}]}}'
    ).encode()


def _time(stamp: int) -> str:
    return f'{{"sec":{stamp // 10**9},"nsec":{stamp % 10**9}}}'


def _point(point: Sequence[float]) -> str:
    x, y, z = point
    return f'{{"x":{x:.7f},"y":{y:.7f},"z":{z:.7f}}}'


def _quaternion(quaternion: Sequence[float]) -> str:
    x, y, z, w = quaternion
    return f'{{"x":{x:.7f},"y":{y:.7f},"z":{z:.7f},"w":{w:.7f}}}'


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> str:
    return f'{{"position":{_point(position)},"orientation":{_quaternion(quaternion)}}}'


def _colour(colour: Colour) -> str:
    return f'{{"r":{colour.red:g},"g":{colour.green:g},"b":{colour.blue:g},"a":{colour.alpha:g}}}'


_HERE = _pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
