"""OpenIGTLink server: packs the robot's state and parses targets, with pyigtl for the types it supports.

OpenIGTLink uses millimetres and RAS (right, anterior, superior). `WORLD_TO_RAS` is the only transform from the world
frame. No client delays another one: for a client that does not read, the server queues only the newest frame.
"""

import asyncio
import contextlib
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from pyigtl.messages import CRC64, MessageBase, PolyDataMessage, TransformMessage

from core.errors import CtrError
from core.robot.robot import Array, Robot
from station.control.states import State
from station.recording.drawing import Pose, rotation_of
from web.gateway.options import ListenAddress
from web.gateway.snapshot import SceneState, Snapshot, StationInfo

#: Matrix that converts world coordinates [m] to RAS [mm]: x is R, y is A and z is S. The client adds the robot's pose
#: in a patient or a phantom.
WORLD_TO_RAS: Array = np.diag([1000.0, 1000.0, 1000.0, 1.0])
_RAS_TO_WORLD: Array = np.diag(1.0 / np.diag(WORLD_TO_RAS))
HEADER_BYTES = MessageBase.IGTL_HEADER_SIZE
#: Types of OpenIGTLink messages that the server sends; messages of the type `TRACKING` are sent only on request.
TRACKING = "TDATA"
MESSAGE_KINDS = ("TRANSFORM", "POLYDATA", "SENSOR", "STATUS", "STRING", TRACKING)
#: Largest body of a received message that the station uses, and of one that it skips, such as an image [bytes].
MAX_BODY_BYTES, MAX_SKIPPED_BYTES = 64 * 1024, 1 << 30
#: Bytes of a skipped message that are in memory at a time.
_SKIP_STEP_BYTES = 64 * 1024
#: Largest number of types of skipped messages that are counted separately.
_MAX_COUNTED_TYPES = 32
#: Name of the TRANSFORM message that may move the robot, if an operator has started a run for targets.
TARGET_NAME = "Target"
#: Largest number of characters in the name of an OpenIGTLink message.
_MAX_NAME_CHARS = 20
#: Binary layout of a matrix (twelve numbers by columns, position last) and of the extended header of version 2.
_MATRIX, _EXTENDED = struct.Struct("> 12f"), struct.Struct("> H H I")
_HEADER = struct.Struct("> H 12s 20s Q Q Q")
#: Prefixes of the message types of requests.
_VERBS = ("GET", "STT", "STP")
#: Unit codes of SENSOR messages: four bits of prefix, then pairs of unit (six bits) and exponent (four bits).
NEWTON = 0x0B << 54
NEWTON_METRE = NEWTON | 1 << 50 | 0x01 << 44 | 1 << 40
#: STATUS code of each station state: ok (1), panic (3), not ready (13), disabled (15), hardware failure (18).
_CODES = {State.READY: 1, State.RUNNING: 1, State.STOPPED: 3, State.OFF: 15, State.FAULT: 18}
_NOT_READY, _BUSY = 13, 6


class BadMessage(CtrError):
    """Received bytes are no valid OpenIGTLink message, or the message is too long."""


class PackedMessage(NamedTuple):
    """An OpenIGTLink message that is ready to send."""

    kind: str
    name: str
    data: bytes


class MessageHead(NamedTuple):
    """Fields of the header of an OpenIGTLink message."""

    kind: str
    name: str
    size: int  #: size of the body [bytes]
    time: float  #: time by the sender's clock [s]; 0: the sender gave none
    version: int
    crc: int

    @property
    def is_used(self) -> bool:
        """Whether the station uses the message: a target, or a request."""
        return (self.kind, self.name) == ("TRANSFORM", TARGET_NAME) or self.kind.partition("_")[0] in _VERBS


class MessageBody(MessageBase):
    """Message with a packed body and pyigtl's header, for types that pyigtl lacks or packs wrongly."""

    def __init__(self, kind: str, body: bytes, **header: Any) -> None:
        super().__init__(**header)
        self._message_type, self._valid_message = kind, True
        self._body = body

    def _pack_content(self) -> Any:
        return self._body


def status(code: int, name: str, text: str) -> bytes:
    """Return the body of a STATUS message."""
    return struct.pack("> H q 20s", code, 0, name.encode()) + text.encode("utf-8", "replace") + b"\0"


def string(text: str) -> bytes:
    """Return the body of a STRING message in UTF-8, because pyigtl accepts only ASCII."""
    encoded = text.encode("utf-8", "replace")
    kind = MessageBase.IANA_CHARACTER_SET_ASCII if text.isascii() else MessageBase.IANA_CHARACTER_SET_UTF8
    return struct.pack("> H H", kind, len(encoded)) + encoded


def sensor(values: Sequence[float], unit: int) -> bytes:
    """Return the body of a SENSOR message."""
    return struct.pack(f"> B B Q {len(values)}d", len(values), 0, unit, *values)


def motion_messages(robot: Robot, scene: SceneState) -> list[PackedMessage]:
    """Return the messages of one frame: tips, bases, centre lines and wrench; unknown values have no message."""
    when = 1e-9 * scene.stamp
    tips = [_transform(f"Tip{name.capitalize()}", pose, when) for name, pose in scene.tips().items()]
    names = [tube.name.capitalize() for tube in robot.tubes]
    bases = [
        _transform(f"{name[: _MAX_NAME_CHARS - 4]}Base", pose, when)
        for name, pose in zip(names, scene.bases, strict=False)
    ]
    lines = [
        _line(f"{name[: _MAX_NAME_CHARS - 4]}Line", points, when)
        for name, points in zip(names, scene.lines, strict=False)
    ]
    wrenches = (("TipForce", scene.force, NEWTON), ("BaseMoment", scene.moment, NEWTON_METRE))
    wrench = [
        _pack(MessageBody("SENSOR", sensor(values.tolist(), unit), **_header(name, when)))
        for name, values, unit in wrenches
        if values is not None
    ]
    return [*tips, *bases, *lines, *wrench]


def state_messages(info: StationInfo, when: float) -> list[PackedMessage]:
    """Return the messages of the station's state and cause, with their time `when` [s]."""
    code = _CODES.get(info.state, _NOT_READY)
    bodies = (
        ("STATUS", "Station", status(code, info.state.name, info.text)),
        ("STRING", "State", string(info.state.name)),
        ("STRING", "Cause", string(info.cause)),
    )
    return [_pack(MessageBody(kind, body, **_header(name, when))) for kind, name, body in bodies]


def refusal(text: str) -> bytes:
    """Return a STATUS message with the reason why a client is refused."""
    return MessageBody("STATUS", status(_BUSY, "BUSY", text), device_name="Station").pack()


def tracking_data(sent: Iterable[PackedMessage], when: float) -> PackedMessage:
    """Return all transforms of a frame as one TDATA message, for clients that request STT_TDATA."""
    # The matrix has the layout of TRANSFORM; the code 2 means an instrument with six degrees of freedom.
    body = b"".join(
        struct.pack("> 20s B x", each.name.encode(), 2) + each.data[HEADER_BYTES:]
        for each in sent
        if each.kind == "TRANSFORM"
    )
    return _pack(MessageBody(TRACKING, body, **_header("Station", when)))


def reply(kind: str, name: str, *, refused: bool) -> bytes:
    """Return the answer `RTS_<kind>`, which reports whether this message type is available."""
    # In UTF-8, as pyigtl packs names, other characters could exceed the length of the field.
    kind, name = (text.encode("ascii", "replace").decode() for text in (kind, name))
    return MessageBody(f"RTS_{kind}"[:12], struct.pack("> B", refused), device_name=name).pack()


def parse_head(data: bytes) -> MessageHead:
    """Parse the header of an OpenIGTLink message; its names may have any bytes.

    Raises:
        BadMessage: the header is invalid, or announces a body that is too long.
    """
    if len(data) != HEADER_BYTES:
        raise BadMessage(f"a header of {len(data)} bytes; expected {HEADER_BYTES}")
    version, *names, stamp, size, crc = _HEADER.unpack(data)
    kind, name = (text.decode("latin-1").partition("\0")[0].rstrip() for text in names)
    head = MessageHead(kind, name, size, stamp / (1 << 32), version, crc)
    if version not in (1, 2, 3):
        raise BadMessage(f"header version {version}; expected 1, 2 or 3")
    if size > (limit := MAX_BODY_BYTES if head.is_used else MAX_SKIPPED_BYTES):
        raise BadMessage(f"a message {kind!r} announces {size} bytes; at most {limit}")
    return head


def parse_target(head: MessageHead, body: bytes) -> Array | None:
    """Return a target in the world frame (3,) [m]; None: the message is no target.

    Raises:
        BadMessage: the target is corrupted, or has no finite position.
    """
    if head.kind != "TRANSFORM" or head.name != TARGET_NAME:
        return None
    if CRC64(body) != head.crc:
        raise BadMessage("the check sum of a target is wrong")
    content = body_content(head, body)
    if len(content) != _MATRIX.size:
        raise BadMessage(f"a target of {len(content)} bytes; a matrix has {_MATRIX.size}")
    position = np.array(_MATRIX.unpack(content)[9:])
    if not np.isfinite(position).all():
        raise BadMessage("the position of a target is not finite")
    world: Array = _RAS_TO_WORLD[:3, :3] @ position
    return world


def body_content(head: MessageHead, body: bytes) -> bytes:
    """Return the body of a message without the extended header and the metadata of version 2."""
    if head.version < 2 or len(body) < _EXTENDED.size:
        return body
    before, names, values = _EXTENDED.unpack(body[: _EXTENDED.size])
    return body[before : len(body) - names - values]


def _transform(name: str, pose: Pose, when: float) -> PackedMessage:
    return _pack(TransformMessage(_matrix(pose), **_header(name, when)))


def _line(name: str, points: Array, when: float) -> PackedMessage:
    return _pack(
        PolyDataMessage(points=points @ WORLD_TO_RAS[:3, :3].T, lines=_one_line(len(points)), **_header(name, when))
    )


def _header(name: str, when: float) -> dict[str, Any]:
    return {"device_name": name, "timestamp": when}


def _pack(message: MessageBase) -> PackedMessage:
    return PackedMessage(message.message_type, message.device_name, message.pack())


def _matrix(pose: Pose) -> Array:
    """Return a pose in the world frame as a matrix (4, 4) in RAS."""
    position, quaternion = pose
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of(quaternion)
    matrix[:3, 3] = position
    return WORLD_TO_RAS @ matrix @ _RAS_TO_WORLD


def _one_line(count: int) -> Array:
    """Return the VTK cell of a line through `count` points."""
    return np.concatenate(([count], np.arange(count)))


#: Largest number of clients; each uses a file descriptor and gets 50 frames a second.
MAX_CLIENTS = 32
#: Socket send buffer of a client that does not read [bytes]; the kernel doubles it.
_SEND_BUFFER_BYTES = 32 * 1024
#: Largest number of answers queued for one client; the oldest are dropped first.
_MAX_PENDING_REPLIES = 32
#: Largest number of entries in a client's sets of stopped and of requested messages together.
_MAX_SUBSCRIPTIONS = 64


class _Frame(NamedTuple):
    """All OpenIGTLink messages of one telemetry snapshot."""

    motion: list[PackedMessage]
    state: list[PackedMessage]  #: the same list object while the state is unchanged
    time: float  #: time of the snapshot [s] since 1970


class IgtlServer:
    """OpenIGTLink server; it runs in the event loop that opens it."""

    def __init__(
        self, robot: Robot, on_target: Callable[[Array, float | None], None], log: Callable[[str], None]
    ) -> None:
        """`on_target` takes a target (3,) [m] in the world frame and its time by the sender's clock [s]."""
        self._robot, self._on_target, self._log = robot, on_target, log
        self.skipped = Counter[str]()  #: number of skipped messages of each type
        self._clients: set[_IgtlClient] = set()
        self._target_source: _IgtlClient | None = None  # the first client that sent a target, until it disconnects
        self._info: StationInfo | None = None
        self._state: list[PackedMessage] = []
        self._server: asyncio.Server | None = None

    async def open(self, address: ListenAddress) -> ListenAddress:
        """Start listening and return the address.

        Raises:
            OSError: the port is not available.
        """
        self._server = await asyncio.start_server(self._serve, address.host, address.port)
        return ListenAddress(address.host, self._server.sockets[0].getsockname()[1])

    @property
    def needs_scene(self) -> bool:
        """Whether a client is connected."""
        return bool(self._clients)

    def publish(self, snapshot: Snapshot) -> None:
        """Offer the newest frame to all clients."""
        now = time.time()
        if snapshot.info != self._info:
            self._info, self._state = snapshot.info, state_messages(snapshot.info, now)
        if not self._clients:
            return
        frame = _Frame([] if snapshot.scene is None else motion_messages(self._robot, snapshot.scene), self._state, now)
        for client in self._clients:
            client.offer(frame)

    async def close(self) -> None:
        """Disconnect all clients."""
        if self._server is not None:
            self._server.close()
        for client in tuple(self._clients):
            client.hang_up()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= MAX_CLIENTS:
            text = f"{len(self._clients)} clients are connected, the limit is {MAX_CLIENTS}; disconnect one"
            with contextlib.suppress(OSError):
                writer.write(refusal(text))
                await writer.drain()
            writer.close()
            return
        client = _IgtlClient(writer)
        self._clients.add(client)
        sending = asyncio.create_task(client.send())
        try:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._receive(client, reader)
        except BadMessage as error:
            self._log(f"OpenIGTLink: a client is disconnected: {error}")
        finally:
            sending.cancel()
            self._clients.discard(client)
            if self._target_source is client:
                self._target_source = None
            client.hang_up()

    async def _receive(self, client: "_IgtlClient", reader: asyncio.StreamReader) -> None:
        while True:
            head = parse_head(await reader.readexactly(HEADER_BYTES))
            if not head.is_used:
                await self._skip(head, reader)
                continue
            body = await reader.readexactly(head.size)
            target = parse_target(head, body)
            if target is None:
                client.handle_request(head.kind, head.name, body_content(head, body))
            elif self._target_source in (None, client):
                # Two clients must not move one tip: the first that sends a target controls it until it disconnects.
                self._target_source = client
                self._on_target(target, head.time or None)

    async def _skip(self, head: MessageHead, reader: asyncio.StreamReader) -> None:
        """Read a message to its end without keeping it; log the 1st, 10th, 100th ... message of each type."""
        for start in range(0, head.size, _SKIP_STEP_BYTES):
            await reader.readexactly(min(_SKIP_STEP_BYTES, head.size - start))
        kind = head.kind if head.kind in self.skipped or len(self.skipped) < _MAX_COUNTED_TYPES else "other types"
        self.skipped[kind] += 1
        count = self.skipped[kind]
        if str(count).rstrip("0") == "1":
            self._log(f"OpenIGTLink: messages of type {kind!r} are skipped, the station does not use them: {count}")


class _IgtlClient:
    """A connected OpenIGTLink client with its queue and its requests."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        connected: socket.socket = writer.get_extra_info("socket")
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        writer.transport.set_write_buffer_limits(high=0)  # no new frame is written while this buffer has data
        self._ready = asyncio.Event()
        self._newest: _Frame | None = None
        self._sent_state: list[PackedMessage] | None = None
        self._answers: deque[bytes] = deque(maxlen=_MAX_PENDING_REPLIES)
        self._stopped: set[tuple[str, str]] = set()  # stopped by STP_: (prefix of the type, name; '': all names)
        self._once: set[tuple[str, str]] = set()  # requested once by GET_: (prefix of the type, name)
        self._tracking: float | None = None  # shortest interval of TDATA [s]; None: not requested
        self._last_tracking = 0.0

    def offer(self, frame: _Frame) -> None:
        """Queue a frame for this client; it replaces an older queued frame."""
        self._newest = frame
        self._ready.set()

    def handle_request(self, kind: str, name: str, body: bytes) -> None:
        """Handle the client's GET_, STT_ and STP_ messages; ignore all others."""
        verb, _, what = kind.partition("_")
        if not what or verb not in _VERBS:
            return
        refused = not any(known.startswith(what) for known in MESSAGE_KINDS)
        if what == TRACKING:
            resolution = struct.unpack("> i", body[:4])[0] if len(body) >= 4 else 0
            self._tracking = 1e-3 * max(0, resolution) if verb == "STT" else None
        elif not refused and len(self._stopped) + len(self._once) < _MAX_SUBSCRIPTIONS:
            if verb == "STP":
                self._stopped.add((what, name))
            elif verb == "STT":
                self._stopped -= {other for other in self._stopped if other[0] == what and name in ("", other[1])}
            else:
                self._once.add((what, name))
        if verb != "GET" or refused:
            self._answers.append(reply(what, name, refused=refused))
            self._ready.set()

    async def send(self) -> None:
        """Send the newest frame as soon as the last one was sent, until cancelled or until the client disconnects."""
        with contextlib.suppress(OSError):
            while True:
                await self._ready.wait()
                self._ready.clear()
                self._writer.write(self._next_bytes())
                await self._writer.drain()

    def hang_up(self) -> None:
        """Disconnect the client without waiting until it has read its data."""
        self._writer.transport.abort()

    def _next_bytes(self) -> bytes:
        answers = b"".join(self._answers)
        self._answers.clear()
        frame, self._newest = self._newest, None
        if frame is None:
            return answers
        unchanged = frame.state is self._sent_state
        self._sent_state = frame.state
        sent = [each for each in frame.motion if self._is_due(each)]
        sent += [each for each in frame.state if (_is_requested(each, self._once) if unchanged else self._is_due(each))]
        self._once.clear()
        if self._tracking is not None and frame.time - self._last_tracking >= self._tracking:
            self._last_tracking = frame.time
            sent.append(tracking_data(frame.motion, frame.time))
        return answers + b"".join(each.data for each in sent)

    def _is_due(self, sent: PackedMessage) -> bool:
        return not _is_requested(sent, self._stopped) or _is_requested(sent, self._once)


def _is_requested(sent: PackedMessage, requested: set[tuple[str, str]]) -> bool:
    """Return whether a message was requested; a request may abbreviate the type (`STT_TRANS`) and omit the name."""
    return any(sent.kind.startswith(kind) and name in ("", sent.name) for kind, name in requested)
