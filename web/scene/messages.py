"""Filter for messages from browsers to the scene. Only camera updates and drags by the operator pass the filter.

viser executes every message of every client, so one client could remove or overwrite the objects that all clients see.
Therefore this filter decodes each message strictly. If the message is known and its values are finite and in range, the
filter encodes the decoded message again and passes it on.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from web.access.identity import Sender
from web.access.lease import Lease
from web.access.tokens import Role

#: Longest accepted message of a browser [bytes]; a camera update has 300 bytes.
MAX_MESSAGE_BYTES = 2048
#: Largest number of messages that one socket may send in a burst, and its largest sustained rate [1/s].
MAX_BURST, MAX_RATE_HZ = 240.0, 120.0
#: Largest accepted coordinate of a camera [scene units]; from farther away nothing is visible.
MAX_CAMERA_DISTANCE = 1e4

Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    pass


class _Camera(_Message, tag="ViewerCameraMessage"):
    wxyz: Quaternion
    position: Vec3
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: Vec3
    up_direction: Vec3


class _Move(_Message, tag="TransformControlsUpdateMessage"):
    name: str
    wxyz: Quaternion
    position: Vec3
    owner: str = ""


class _MoveStart(_Message, tag="TransformControlsDragStartMessage"):
    name: str
    owner: str = ""


class _MoveEnd(_Message, tag="TransformControlsDragEndMessage"):
    name: str
    owner: str = ""


_decoder = msgspec.msgpack.Decoder(_Camera | _Move | _MoveStart | _MoveEnd)
_encoder = msgspec.msgpack.Encoder()


class HandleBox(NamedTuple):
    """Box within which a handle may be dragged [scene units]."""

    lower: Vec3
    upper: Vec3

    def contains(self, point: Vec3) -> bool:
        """Return whether a point is inside the box."""
        return all(low <= x <= up for low, x, up in zip(self.lower, point, self.upper, strict=True))


@dataclass
class MessageGate:
    """Filter for the messages of one browser's socket."""

    gizmos: Mapping[str, HandleBox]  #: handles that the operator may drag, by name
    lease: Lease
    who: Sender
    clock: Callable[[], float]  #: returns the time [s]
    report: Callable[[str], None]  #: called once for each reason, so that many messages cannot fill the log
    dropped: Counter[str] = field(default_factory=Counter)  #: number of dropped messages by reason
    _credit: float = MAX_BURST
    _last: float = 0.0

    def passes(self, data: bytes | str | None) -> bytes | None:
        """Return the message to pass on to viser; None: the message was dropped and counted in `dropped`."""
        now = self.clock()
        self._credit, self._last = min(MAX_BURST, self._credit + MAX_RATE_HZ * (now - self._last)), now
        if self._credit < 1.0:
            return self._drop("messages faster than a user can send them")
        self._credit -= 1.0
        if not isinstance(data, bytes) or len(data) > MAX_MESSAGE_BYTES:
            return self._drop("not a message of the scene")
        try:
            message = _decoder.decode(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return self._drop("an unknown or invalid message")
        refused = self._refusal(message)
        return _encoder.encode(message) if refused is None else self._drop(refused)

    def _refusal(self, message: Any) -> str | None:
        match message:
            case _Camera():
                numbers = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
                sizes = (message.fov, message.near, message.far, message.image_height, message.image_width)
                good = all(abs(x) <= MAX_CAMERA_DISTANCE for x in numbers) and all(0.0 < x <= 1e5 for x in sizes)
                return None if good else "a camera out of range"
            case _:
                return self._refused_drag(message)

    def _refused_drag(self, message: _Move | _MoveStart | _MoveEnd) -> str | None:
        box = self.gizmos.get(message.name)
        if box is None or message.owner:
            return "a drag of an object that cannot be dragged"
        if self.who.role is not Role.OPERATOR or not self.lease.holds(self.who.client):
            return "a drag by a client that is not operator"
        if not isinstance(message, _Move):
            return None
        turned = abs(math.hypot(*message.wxyz) - 1.0) <= 1e-3  # written so that NaN is refused, too
        return None if turned and box.contains(message.position) else "a drag out of range"

    def _drop(self, reason: str) -> None:
        if not self.dropped[reason]:
            self.report(reason)
        self.dropped[reason] += 1
