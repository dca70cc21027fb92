"""What a browser may say to the scene: where its camera is, and a drag by the operator.

viser obeys any message of any client: it would let one remove or overwrite what all see. So each is
read strictly here, and only what is known, finite and in range goes on, written anew.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from web.access.identity import Who
from web.access.lease import Lease
from web.access.tokens import Role

#: Longest message that is read [bytes]; a camera takes 300.
LONGEST = 2048
#: Messages that one socket may send: so many at once, and so many a second for ever.
BURST, RATE = 240.0, 120.0
#: Scene units; a camera further away sees nothing anyway.
FAR = 1e4

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


class Box(NamedTuple):
    """Where something may be dragged to, scene units."""

    lower: Vec3
    upper: Vec3

    def holds(self, place: Vec3) -> bool:
        """Whether a place is inside."""
        return all(low <= x <= up for low, x, up in zip(self.lower, place, self.upper, strict=True))


@dataclass
class Gate:
    """One socket's way in."""

    gizmos: Mapping[str, Box]  #: what the operator may drag, by name
    lease: Lease
    who: Who
    clock: Callable[[], float]  #: [s]
    report: Callable[[str], None]  #: told of each reason once: a flood must not fill a log
    dropped: Counter[str] = field(default_factory=Counter)  #: by reason
    _room: float = BURST
    _then: float = 0.0

    def passes(self, data: bytes | str | None) -> bytes | None:
        """The message as it goes on to viser; None for one that does not, which is counted in `dropped`."""
        now = self.clock()
        self._room, self._then = min(BURST, self._room + RATE * (now - self._then)), now
        if self._room < 1.0:
            return self._drop("more than a person can send")
        self._room -= 1.0
        if not isinstance(data, bytes) or len(data) > LONGEST:
            return self._drop("no message of a scene")
        try:
            message = _decoder.decode(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return self._drop("no message that is known here")
        refused = self._refusal(message)
        return _encoder.encode(message) if refused is None else self._drop(refused)

    def _refusal(self, message: Any) -> str | None:
        match message:
            case _Camera():
                numbers = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
                sizes = (message.fov, message.near, message.far, message.image_height, message.image_width)
                good = all(abs(x) <= FAR for x in numbers) and all(0.0 < x <= 1e5 for x in sizes)
                return None if good else "a camera out of range"
            case _:
                return self._refused_drag(message)

    def _refused_drag(self, message: _Move | _MoveStart | _MoveEnd) -> str | None:
        box = self.gizmos.get(message.name)
        if box is None or message.owner:
            return "a drag of what cannot be dragged"
        if self.who.role is not Role.OPERATOR or not self.lease.holds(self.who.client):
            return "a drag by somebody who is not operator"
        if not isinstance(message, _Move):
            return None
        turned = abs(math.hypot(*message.wxyz) - 1.0) <= 1e-3  # what is no number is not, either
        return None if turned and box.holds(message.position) else "a drag out of range"

    def _drop(self, reason: str) -> None:
        if not self.dropped[reason]:
            self.report(reason)
        self.dropped[reason] += 1
