"""OpenIGTLink server: a client that reads gets the newest frame, and no client delays another client.

For a client that does not read, the server queues only the newest frame, in addition to the socket's buffer.
"""

import asyncio
import contextlib
import socket
import struct
import time
from collections import deque
from typing import NamedTuple, Protocol

from core.robot.robot import Array, Robot
from web.gateway.igtl.messages import (
    HEADER_BYTES,
    MESSAGE_KINDS,
    TRACKING,
    BadMessage,
    PackedMessage,
    body_content,
    motion_messages,
    parse_head,
    parse_target,
    refusal,
    reply,
    state_messages,
    tracking_data,
)
from web.gateway.options import ListenAddress
from web.gateway.snapshot import Snapshot, StationInfo

#: Largest number of clients; each uses a file descriptor and gets 50 frames a second.
MAX_CLIENTS = 32
#: Socket send buffer of a client that does not read [bytes]; the kernel doubles it.
_SEND_BUFFER_BYTES = 32 * 1024
#: Largest number of answers queued for one client; the oldest are dropped first.
_MAX_PENDING_REPLIES = 32
#: Largest number of entries in a client's sets of stopped and of requested messages together.
_MAX_SUBSCRIPTIONS = 64


class TargetHandler(Protocol):
    """Function that receives the targets of OpenIGTLink clients."""

    def __call__(self, position: Array, sent: float | None) -> None:
        """Take the target `position` (3,) [m] in the world frame, and the time `sent` by the sender's clock [s]."""
        ...


class _Frame(NamedTuple):
    """All OpenIGTLink messages of one telemetry snapshot."""

    motion: list[PackedMessage]
    state: list[PackedMessage]  #: the same list object while the state is unchanged
    time: float  #: time of the snapshot [s] since 1970


class IgtlServer:
    """OpenIGTLink server; it runs in the event loop that opens it."""

    def __init__(self, robot: Robot, on_target: TargetHandler) -> None:
        self._robot, self._on_target = robot, on_target
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
            with contextlib.suppress(BadMessage, OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._receive(client, reader)
        finally:
            sending.cancel()
            self._clients.discard(client)
            if self._target_source is client:
                self._target_source = None
            client.hang_up()

    async def _receive(self, client: "_IgtlClient", reader: asyncio.StreamReader) -> None:
        while True:
            head = parse_head(await reader.readexactly(HEADER_BYTES))
            body = await reader.readexactly(head.size)
            target = parse_target(head, body)
            if target is None:
                client.handle_request(head.kind, head.name, body_content(head, body))
            elif self._target_source in (None, client):
                # Two clients must not move one tip: the first that sends a target controls it until it disconnects.
                self._target_source = client
                self._on_target(target, head.time or None)


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
        if not what or verb not in ("GET", "STT", "STP"):
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
