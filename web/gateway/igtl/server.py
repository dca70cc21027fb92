"""The OpenIGTLink server: everybody gets the newest, as often as they read, and nobody waits for anybody.

A client that does not read has one frame waiting, the newest, beside what its socket holds: nothing piles up.
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
    HEADER,
    KINDS,
    TRACKING,
    BadMessage,
    Packed,
    answer,
    content_of,
    head_of,
    moving,
    standing,
    target_of,
    tracking_data,
)
from web.gateway.seen import Look, Told
from web.gateway.wanted import Address

#: What the system keeps for a client that does not read [bytes]; it makes two of each.
_BUFFER = 32 * 1024
#: Answers that wait for one; whoever asks without reading gets the newest.
_ANSWERS = 32
#: That one may have of what it wants and what not.
_MOST_WISHES = 64


class OnTarget(Protocol):
    """Who hears of targets."""

    def __call__(self, place: Array, sent: float | None) -> None:
        """Where (3,) [m] in the world, and when by the sender's clock [s]."""
        ...


class _Frame(NamedTuple):
    """All there is to send at one moment."""

    moving: list[Packed]
    standing: list[Packed]  #: the same list as long as nothing has changed
    time: float  #: [s] since 1970


class IgtlServer:
    """One of them, in the event loop that opens it."""

    def __init__(self, robot: Robot, on_target: OnTarget) -> None:
        self._robot, self._on_target = robot, on_target
        self._clients: set[_Client] = set()
        self._leader: _Client | None = None  # the first that has sent a target, until it leaves
        self._told: Told | None = None
        self._standing: list[Packed] = []
        self._server: asyncio.Server | None = None

    async def open(self, address: Address) -> Address:
        """Listen; where.

        Raises:
            OSError: that port cannot be had.
        """
        self._server = await asyncio.start_server(self._serve, address.host, address.port)
        return Address(address.host, self._server.sockets[0].getsockname()[1])

    @property
    def watched(self) -> bool:
        """Whether anybody is there."""
        return bool(self._clients)

    def publish(self, look: Look) -> None:
        """Give everybody the newest."""
        now = time.time()
        if look.told != self._told:
            self._told, self._standing = look.told, standing(look.told, now)
        if not self._clients:
            return
        frame = _Frame([] if look.seen is None else moving(self._robot, look.seen), self._standing, now)
        for client in self._clients:
            client.offer(frame)

    async def close(self) -> None:
        """Hang up."""
        if self._server is not None:
            self._server.close()
        for client in tuple(self._clients):
            client.hang_up()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = _Client(writer)
        self._clients.add(client)
        sending = asyncio.create_task(client.send())
        try:
            with contextlib.suppress(BadMessage, OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
                await self._hear(client, reader)
        finally:
            sending.cancel()
            self._clients.discard(client)
            if self._leader is client:
                self._leader = None
            client.hang_up()

    async def _hear(self, client: "_Client", reader: asyncio.StreamReader) -> None:
        while True:
            head = head_of(await reader.readexactly(HEADER))
            body = await reader.readexactly(head.size)
            place = target_of(head, body)
            if place is None:
                client.asked(head.kind, head.name, content_of(head, body))
            elif self._leader in (None, client):
                # Two who pull at one tip would tear it: the first has it until it leaves.
                self._leader = client
                self._on_target(place, head.time or None)


class _Client:
    """One who is connected: what waits for it, and what it wants."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        connected: socket.socket = writer.get_extra_info("socket")
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        writer.transport.set_write_buffer_limits(high=0)  # whoever has not read the last gets nothing more
        self._something = asyncio.Event()
        self._newest: _Frame | None = None
        self._said: list[Packed] | None = None
        self._answers: deque[bytes] = deque(maxlen=_ANSWERS)
        self._stopped: set[tuple[str, str]] = set()  # kinds, as they begin, and names; all names where that is empty
        self._once: set[tuple[str, str]] = set()
        self._tracking: float | None = None  # TDATA, so many seconds apart at least
        self._tracked = 0.0

    def offer(self, frame: _Frame) -> None:
        """Takes the place of one that is still waiting."""
        self._newest = frame
        self._something.set()

    def asked(self, kind: str, name: str, body: bytes) -> None:
        """GET_, STT_ and STP_ of anything; all else is not for us."""
        verb, _, what = kind.partition("_")
        if not what or verb not in ("GET", "STT", "STP"):
            return
        refused = not any(known.startswith(what) for known in KINDS)
        if what == TRACKING:
            resolution = struct.unpack("> i", body[:4])[0] if len(body) >= 4 else 0
            self._tracking = 1e-3 * max(0, resolution) if verb == "STT" else None
        elif not refused and len(self._stopped) + len(self._once) < _MOST_WISHES:
            if verb == "STP":
                self._stopped.add((what, name))
            elif verb == "STT":
                self._stopped -= {other for other in self._stopped if other[0] == what and name in ("", other[1])}
            else:
                self._once.add((what, name))
        if verb != "GET" or refused:
            self._answers.append(answer(what, name, refused=refused))
            self._something.set()

    async def send(self) -> None:
        """Send the newest whenever the last has gone; until cancelled, or until nobody is there."""
        with contextlib.suppress(OSError):
            while True:
                await self._something.wait()
                self._something.clear()
                self._writer.write(self._all())
                await self._writer.drain()

    def hang_up(self) -> None:
        """Without waiting for what it has not read."""
        self._writer.transport.abort()

    def _all(self) -> bytes:
        answers = b"".join(self._answers)
        self._answers.clear()
        frame, self._newest = self._newest, None
        if frame is None:
            return answers
        old = frame.standing is self._said
        self._said = frame.standing
        sent = [each for each in frame.moving if self._once_or_always(each)]
        sent += [each for each in frame.standing if (_is_any(each, self._once) if old else self._once_or_always(each))]
        self._once.clear()
        if self._tracking is not None and frame.time - self._tracked >= self._tracking:
            self._tracked = frame.time
            sent.append(tracking_data(frame.moving, frame.time))
        return answers + b"".join(each.data for each in sent)

    def _once_or_always(self, sent: Packed) -> bool:
        return not _is_any(sent, self._stopped) or _is_any(sent, self._once)


def _is_any(sent: Packed, wanted: set[tuple[str, str]]) -> bool:
    """Whether it was asked for: names of queries are cut (`STT_TRANS`), and no name means all."""
    return any(sent.kind.startswith(kind) and name in ("", sent.name) for kind, name in wanted)
