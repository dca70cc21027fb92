"""Foxglove, live: the topics and schemas of the recordings, behind the same gate as the page.

The SDK's own server knows neither hosts nor origins nor tokens, so the protocol is spoken here. What waits for a
client that reads slowly is bounded; the oldest goes first.
"""

import asyncio
import contextlib
import secrets
import socket
from collections import deque
from http import HTTPStatus
from time import time_ns
from typing import Any

from starlette.types import Receive, Scope, Send
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from core.robot.robot import Robot
from station.control.states import State
from station.control.telemetry import Channels
from station.recording.data_section import Topic
from station.recording.drawing import Drawing
from station.recording.events import INFO, TOPIC, WARNING, Event, event_json
from station.recording.events import SCHEMA as EVENTS_SCHEMA
from station.recording.foxglove import json_topic
from station.recording.row_message import SCHEMA, definition
from station.recording.row_message import TOPIC as ROWS_TOPIC
from station.recording.writer import DRAWN, EVENT, ROWS
from web.access.gate import Access
from web.access.tokens import Tokens
from web.gateway.foxglove import protocol
from web.gateway.seen import Look, Told
from web.gateway.wanted import Address

#: Pages of other sites that may look: Foxglove's own, and programs on this computer that are made of pages. They have
#: to bring a token like everybody else where one is demanded.
PAGES = frozenset({"https://app.foxglove.dev", "file://"})
#: Messages that wait for one client, a third of a second of everything.
_WAITING = 256
#: What the system keeps for a client besides [bytes].
_BUFFER = 128 * 1024
#: Every second look is drawn: 25 pictures a second.
_DRAWN = 2
#: A client has no more to say [bytes].
_LONGEST = 64 * 1024
#: Subscriptions of one client, and clients.
_MOST = 64
#: That a library keeps for a client before it waits [bytes].
_WRITTEN = 32 * 1024


class FoxgloveServer:
    """One of them, in the event loop that opens it."""

    def __init__(self, robot: Robot, channels: Channels, tokens: Tokens | None) -> None:
        """`tokens` are demanded; None: from nobody."""
        self._drawing = Drawing(robot, channels.all, DRAWN)
        self._topics = (
            Topic(ROWS_TOPIC, "ros1", SCHEMA, "ros1msg", definition(channels.all)),
            json_topic(TOPIC, EVENTS_SCHEMA),
            *self._drawing.topics,
        )
        self._tokens = tokens
        self._clients: set[_Client] = set()
        self._session = secrets.token_hex(8)
        self._looks = 0
        self._told = Told()
        self._event: tuple[int, bytes] | None = None  # the last, for those who come later
        self._server: Server | None = None

    async def open(self, address: Address) -> Address:
        """Listen; where.

        Raises:
            OSError: that port cannot be had.
        """
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        listening = socket.create_server((address.host, address.port), family=family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)  # of every connection
        port = int(listening.getsockname()[1])
        # What comes in by it is looked at here and goes no further.
        access = Access(_nothing, address.host, port, self._tokens, PAGES)

        def judge(connection: ServerConnection, request: Request) -> Response | None:
            refusal = access.refused(_scope_of(request))
            if refusal is None and len(self._clients) >= _MOST:
                refusal = HTTPStatus.SERVICE_UNAVAILABLE, "too many are connected"
            return None if refusal is None else connection.respond(HTTPStatus(refusal[0]), f"{refusal[1]}\n")

        self._server = await serve(
            self._serve, sock=listening, process_request=judge, compression=None, max_size=_LONGEST,
            subprotocols=[Subprotocol(name) for name in protocol.SUBPROTOCOLS], write_limit=_WRITTEN,
        )  # fmt: skip
        return Address(address.host, port)

    @property
    def watched(self) -> bool:
        """Whether anybody wants to see the robot drawn."""
        return any(channel >= DRAWN for client in self._clients for channel in client.channels)

    def publish(self, look: Look) -> None:
        """Give everybody what they have subscribed to."""
        if look.told != self._told:
            self._hear(look)
        self._looks += 1
        for client in self._clients:
            for subscription in client.channels.get(ROWS, ()):
                for row, stamp in zip(look.rows, look.stamps.tolist(), strict=True):
                    client.say(protocol.message_data(subscription, stamp, row.astype("<f8").tobytes()))
        seen = look.seen
        if seen is None or self._looks % _DRAWN or not self.watched:
            return
        for said in self._drawing.posed(seen.row, seen.posed, seen.stamp):
            self._say(said.topic, said.time, said.data)

    async def close(self) -> None:
        """Hang up."""
        if self._server is not None:
            self._server.close()
            for client in tuple(self._clients):
                client.connection.transport.abort()

    def _hear(self, look: Look) -> None:
        """News from the station: an event, as in the recordings, and gains."""
        told, before = look.told, self._told
        self._told = told
        if told.text != before.text:
            bad = told.state in (State.HOLD, State.FAULT)
            time = float(look.rows[-1, 0]) if len(look.rows) else 0.0
            stamp = int(look.stamps[-1]) if len(look.rows) else time_ns()
            self._event = stamp, event_json(Event(time, "state", told.text, WARNING if bad else INFO), stamp)
            self._say(EVENT, *self._event)
        changed = set(told.gains) - set(before.gains)
        for client in self._clients:
            if news := [(name, value) for name, value in changed if name in client.parameters]:
                client.say(protocol.parameter_values(news))

    def _say(self, channel: int, stamp: int, data: bytes) -> None:
        for client in self._clients:
            for subscription in client.channels.get(channel, ()):
                client.say(protocol.message_data(subscription, stamp, data))

    async def _serve(self, connection: ServerConnection) -> None:
        """One who has come through the gate."""
        client = _Client(connection)
        client.say(protocol.server_info(self._session))
        client.say(protocol.advertise(self._topics))
        self._clients.add(client)
        sending = asyncio.create_task(client.send())
        try:
            async for message in connection:
                self._wish(client, protocol.asked(message))
        except ConnectionClosed:
            return  # without a word
        finally:
            self._clients.discard(client)
            sending.cancel()

    def _wish(self, client: "_Client", wish: dict[str, Any]) -> None:
        match wish:
            case {"op": "subscribe", "subscriptions": [*subscriptions]}:
                for each in subscriptions:
                    if isinstance(each, dict):
                        self._subscribe(client, protocol.whole_numbers([each.get("id"), each.get("channelId")]))
            case {"op": "unsubscribe", "subscriptionIds": ids}:
                for number in protocol.whole_numbers(ids):
                    client.subscriptions.pop(number, None)
            case {"op": "getParameters", "parameterNames": names}:
                client.say(protocol.parameter_values(self._gains(names), wish.get("id")))
            case {"op": "setParameters"}:
                client.say(protocol.status("the gains are read-only here; set them on the station's page"))
                client.say(protocol.parameter_values(self._told.gains, wish.get("id")))
            case {"op": "subscribeParameterUpdates", "parameterNames": names}:
                client.parameters |= {name for name, _ in self._gains(names)}
            case {"op": "unsubscribeParameterUpdates", "parameterNames": names}:
                client.parameters -= {name for name, _ in self._gains(names)}
            case _:
                return

    def _gains(self, names: Any) -> list[tuple[str, float | str | bool]]:
        """Those that are named; all where none is."""
        wanted = protocol.words(names)
        return [gain for gain in self._told.gains if not wanted or gain[0] in wanted]

    def _subscribe(self, client: "_Client", told: list[int]) -> None:
        if len(told) != 2 or not 1 <= told[1] <= len(self._topics):
            client.say(protocol.status("there is no such channel"))
            return
        if len(client.subscriptions) >= _MOST or told[0] in client.subscriptions:
            client.say(protocol.status("that subscription is taken"))
            return
        client.subscriptions[told[0]] = told[1]
        if told[1] == EVENT and self._event is not None:
            client.say(protocol.message_data(told[0], *self._event))


class _Client:
    """One who is connected."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.subscriptions: dict[int, int] = {}  #: channel by id
        self.parameters: set[str] = set()  #: whose news it wants
        self._waiting: deque[str | bytes] = deque(maxlen=_WAITING)
        self._something = asyncio.Event()

    @property
    def channels(self) -> dict[int, list[int]]:
        """Ids by channel."""
        found: dict[int, list[int]] = {}
        for number, channel in self.subscriptions.items():
            found.setdefault(channel, []).append(number)
        return found

    def say(self, what: str | bytes) -> None:
        """Soon; never waits."""
        self._waiting.append(what)
        self._something.set()

    async def send(self) -> None:
        """One after the other; until cancelled, or until nobody is there."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._something.wait()
                self._something.clear()
                while self._waiting:
                    await self.connection.send(self._waiting.popleft())


def _scope_of(request: Request) -> Scope:
    """The request of a websocket as the gate knows it."""
    path, _, query = request.path.partition("?")
    headers = [(name.lower().encode("latin-1"), value.encode("latin-1")) for name, value in request.headers.raw_items()]
    return {"type": "websocket", "path": path, "query_string": query.encode("latin-1"), "headers": headers}


async def _nothing(_scope: Scope, _receive: Receive, _send: Send) -> None:
    """Nobody gets here."""
