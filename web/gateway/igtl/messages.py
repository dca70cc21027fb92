"""OpenIGTLink messages of what is seen, and a target out of bytes. pyigtl packs what it knows; the rest is here.

OpenIGTLink is in millimetres and RAS (right, anterior, superior). `RAS` is the one way from the world to there.
"""

import struct
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from pyigtl.messages import CRC64, MessageBase, PolyDataMessage, TransformMessage

from core.errors import CtrError
from core.robot.robot import Array, Robot
from station.control.states import State
from station.recording.posed import Pose
from web.gateway.seen import Seen, Told

#: World [m] to RAS [mm]: x is R, y is A and z is S. How the robot lies in a patient or a phantom is for the other side.
RAS: Array = np.diag([1000.0, 1000.0, 1000.0, 1.0])
_WORLD: Array = np.diag(1.0 / np.diag(RAS))
HEADER = MessageBase.IGTL_HEADER_SIZE
#: What is sent, and what only to those who ask for it.
TRACKING = "TDATA"
KINDS = ("TRANSFORM", "POLYDATA", "SENSOR", "STATUS", "STRING", TRACKING)
#: Nobody has to send us more [bytes].
LONGEST_BODY = 64 * 1024
#: Name of the only message that may ask the robot for something, if an operator has started a run for it.
TARGET = "Target"
#: The longest name of a message [letters].
_NAME = 20
#: Twelve numbers, column by column, the place last; and what version 2 says of its extended header and its metadata.
_MATRIX, _EXTENDED = struct.Struct("> 12f"), struct.Struct("> H H I")
#: Units of SENSOR: six bits a unit and four an exponent, after four of a prefix; the first two are used here.
NEWTON = 0x0B << 54
NEWTON_METRE = NEWTON | 1 << 50 | 0x01 << 44 | 1 << 40
#: Codes of STATUS: all is well, panic, not ready, disabled, hardware failure.
_CODES = {State.READY: 1, State.RUNNING: 1, State.STOPPED: 3, State.OFF: 15, State.FAULT: 18}
_NOT_READY = 13


class BadMessage(CtrError):
    """Bytes that are no OpenIGTLink, or more than anybody has to send."""


class Packed(NamedTuple):
    """A message as it goes out."""

    kind: str
    name: str
    data: bytes


class Head(NamedTuple):
    """What a header says."""

    kind: str
    name: str
    size: int  #: of the body [bytes]
    time: float  #: by the sender's clock [s]; 0: not told
    version: int
    crc: int


class Body(MessageBase):
    """A message that pyigtl does not have, or not as it should be: its bytes in pyigtl's header."""

    def __init__(self, kind: str, body: bytes, **header: Any) -> None:
        super().__init__(**header)
        self._message_type, self._valid_message = kind, True
        self._body = body

    def _pack_content(self) -> Any:
        return self._body


def status(code: int, name: str, text: str) -> bytes:
    """Of STATUS."""
    return struct.pack("> H q 20s", code, 0, name.encode()) + text.encode("utf-8", "replace") + b"\0"


def string(text: str) -> bytes:
    """Of STRING; pyigtl's own takes no letters beyond ASCII."""
    told = text.encode("utf-8", "replace")
    kind = MessageBase.IANA_CHARACTER_SET_ASCII if text.isascii() else MessageBase.IANA_CHARACTER_SET_UTF8
    return struct.pack("> H H", kind, len(told)) + told


def sensor(values: Sequence[float], unit: int) -> bytes:
    """Of SENSOR."""
    return struct.pack(f"> B B Q {len(values)}d", len(values), 0, unit, *values)


def moving(robot: Robot, seen: Seen) -> list[Packed]:
    """What changes all the time: tips, bases, centre lines, wrench. What is not known now is not there."""
    when = 1e-9 * seen.stamp
    tips = [_transform(f"Tip{name.capitalize()}", pose, when) for name, pose in seen.tips().items()]
    names = [tube.name.capitalize() for tube in robot.tubes]
    bases = [_transform(f"{name[: _NAME - 4]}Base", pose, when) for name, pose in zip(names, seen.bases, strict=False)]
    lines = [_line(f"{name[: _NAME - 4]}Line", points, when) for name, points in zip(names, seen.lines, strict=False)]
    felt = (("TipForce", seen.force, NEWTON), ("BaseMoment", seen.moment, NEWTON_METRE))
    wrench = [
        _pack(Body("SENSOR", sensor(values.tolist(), unit), **_header(name, when)))
        for name, values, unit in felt
        if values is not None
    ]
    return [*tips, *bases, *lines, *wrench]


def standing(told: Told, when: float) -> list[Packed]:
    """What changes now and then: state and cause, since `when` [s]."""
    code = _CODES.get(told.state, _NOT_READY)
    bodies = (
        ("STATUS", "Station", status(code, told.state.name, told.text)),
        ("STRING", "State", string(told.state.name)),
        ("STRING", "Cause", string(told.cause)),
    )
    return [_pack(Body(kind, body, **_header(name, when))) for kind, name, body in bodies]


def tracking_data(sent: Iterable[Packed], when: float) -> Packed:
    """All transforms of what is sent as one message, for those who ask for it with STT_TDATA."""
    # The matrix is laid out as in TRANSFORM; 2: an instrument with six degrees of freedom.
    body = b"".join(
        struct.pack("> 20s B x", each.name.encode(), 2) + each.data[HEADER:]
        for each in sent
        if each.kind == "TRANSFORM"
    )
    return _pack(Body(TRACKING, body, **_header("Station", when)))


def answer(kind: str, name: str, *, refused: bool) -> bytes:
    """RTS_`kind`: whether it can be had."""
    return Body(f"RTS_{kind}"[:12], struct.pack("> B", refused), device_name=name).pack()


def head_of(data: bytes) -> Head:
    """The header of a message.

    Raises:
        BadMessage: it is none, or announces more than `LONGEST_BODY`.
    """
    try:
        told = MessageBase.parse_header(data)
    except (struct.error, UnicodeDecodeError) as error:
        raise BadMessage(f"not an OpenIGTLink header: {error}") from None
    (crc,) = struct.unpack("> Q", data[HEADER - 8 :])
    if told["header_version"] not in (1, 2) or told["body_size"] > LONGEST_BODY:
        raise BadMessage(f"version {told['header_version']} with {told['body_size']} bytes; at most {LONGEST_BODY}")
    kind, name = (str(told[key]).partition("\0")[0] for key in ("message_type", "device_name"))
    return Head(kind, name, told["body_size"], told["timestamp"], told["header_version"], crc)


def target_of(head: Head, body: bytes) -> Array | None:
    """Where the target is, in the world (3,) [m]; None: this is not a target.

    Raises:
        BadMessage: one that was damaged on its way, or that tells no place.
    """
    if head.kind != "TRANSFORM" or head.name != TARGET:
        return None
    if CRC64(body) != head.crc:
        raise BadMessage("a target whose check sum is wrong")
    content = content_of(head, body)
    if len(content) != _MATRIX.size:
        raise BadMessage(f"a target of {len(content)} bytes; {_MATRIX.size} are a matrix")
    place = np.array(_MATRIX.unpack(content)[9:])
    if not np.isfinite(place).all():
        raise BadMessage("a target that is nowhere")
    world: Array = _WORLD[:3, :3] @ place
    return world


def content_of(head: Head, body: bytes) -> bytes:
    """A body without what version 2 puts around it: an extended header before, metadata behind."""
    if head.version < 2 or len(body) < _EXTENDED.size:
        return body
    before, names, values = _EXTENDED.unpack(body[: _EXTENDED.size])
    return body[before : len(body) - names - values]


def _transform(name: str, pose: Pose, when: float) -> Packed:
    return _pack(TransformMessage(_matrix(pose), **_header(name, when)))


def _line(name: str, points: Array, when: float) -> Packed:
    return _pack(PolyDataMessage(points=points @ RAS[:3, :3].T, lines=_one_line(len(points)), **_header(name, when)))


def _header(name: str, when: float) -> dict[str, Any]:
    return {"device_name": name, "timestamp": when}


def _pack(message: MessageBase) -> Packed:
    return Packed(message.message_type, message.device_name, message.pack())


def _matrix(pose: Pose) -> Array:
    """A pose in the world as a matrix (4, 4) in RAS."""
    position, (x, y, z, w) = pose
    matrix = np.eye(4)
    matrix[:3, :3] = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    matrix[:3, 3] = position
    return RAS @ matrix @ _WORLD


def _one_line(count: int) -> Array:
    """Cells of a line through so many points, as VTK has them."""
    return np.concatenate(([count], np.arange(count)))
