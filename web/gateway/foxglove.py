"""Live Foxglove server with the same topics and schemas as the recordings, and the same access checks as the page.

The server of Foxglove's SDK checks neither hosts nor origins nor tokens, so the protocol is implemented here, as
specified at https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md. Its subprotocol `foxglove.websocket.v1` and
the subprotocol of Foxglove's SDK, `foxglove.sdk.v1`, have the same messages. The message queue of a slow client is
bounded; the oldest messages are dropped first.
"""

import asyncio
import contextlib
import json
import logging
import secrets
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterable, Sequence
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
from station.recording.data_section import TELEMETRY_SCHEMA as SCHEMA
from station.recording.data_section import TELEMETRY_TOPIC as ROWS_TOPIC
from station.recording.data_section import RowFormat, Topic
from station.recording.drawing import Drawing
from station.recording.foxglove import EVENTS_SCHEMA, EVENTS_TOPIC, INFO, WARNING, RecordedEvent, event_json, json_topic
from station.recording.writer import EVENT_CHANNEL, FIRST_DRAWING_CHANNEL, ROWS_CHANNEL
from web.access.gate import Access
from web.access.identity import Tokens
from web.gateway.options import ListenAddress
from web.gateway.snapshot import Snapshot, StationInfo

#: Names of the supported WebSocket subprotocols, newest first; both define the same messages.
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
#: Level of a status message that reports a warning.
WARNING_LEVEL = 1
#: First byte of the server's binary message that contains data of a subscribed channel.
_MESSAGE_DATA = 1

Gains = Iterable[tuple[str, float | str | bool]]


def server_info(session: str) -> str:
    """Return the first message to a client: the server's name and capabilities."""
    return json.dumps({
        "op": "serverInfo", "name": "ctr-station", "capabilities": ["parameters", "parametersSubscribe"],
        "metadata": {}, "sessionId": session,
    })  # fmt: skip


def advertise(topics: Sequence[Topic]) -> str:
    """Return the message that lists the channels; a channel's id is its position, from 1, as in the recordings."""
    channels = [
        {"id": number, "topic": topic.name, "encoding": topic.encoding, "schemaName": topic.schema,
         "schemaEncoding": topic.schema_encoding, "schema": topic.definition}
        for number, topic in enumerate(topics, start=1)
    ]  # fmt: skip
    return json.dumps({"op": "advertise", "channels": channels})


def parameter_values(gains: Gains, request: str | None = None) -> str:
    """Return the message with the controller's parameters: the answer to a `request`, or an update without one."""
    parameters = [
        {"name": name, "value": value, **({"type": "float64"} if isinstance(value, float) else {})}
        for name, value in gains
    ]
    return json.dumps(
        {"op": "parameterValues", "parameters": parameters, **({} if request is None else {"id": request})}
    )


def status(text: str) -> str:
    """Return a status message that shows `text` as a warning."""
    return json.dumps({"op": "status", "level": WARNING_LEVEL, "message": text})


def message_data(subscription: int, stamp: int, data: bytes) -> bytes:
    """Return a message of a subscribed channel with its time `stamp` [ns] since 1970."""
    return struct.pack("<BIQ", _MESSAGE_DATA, subscription, stamp) + data


def client_requests(text: str | bytes) -> dict[str, Any]:
    """Return the request of a client; empty if it is invalid or publishes data."""
    if isinstance(text, bytes):
        return {}
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def whole_numbers(values: Any) -> list[int]:
    """Return the entries of a list that are valid channel or subscription ids."""
    return (
        [value for value in values if type(value) is int and 0 <= value < 1 << 32] if isinstance(values, list) else []
    )


def string_list(values: Any) -> list[str]:
    """Return the entries of a list that are strings."""
    return [value for value in values if isinstance(value, str)] if isinstance(values, list) else []


#: Origins that may connect in addition to the station's page: Foxglove's page, and desktop programs. A client with one
#: of these origins also needs a token if the station requires tokens.
ALLOWED_ORIGINS = frozenset({"https://app.foxglove.dev", "file://"})
#: What to do to allow a refused origin.
ORIGIN_HINT = "; if you trust these pages, add this origin to the key gateway_origins of the station file"
#: Largest number of messages queued for one client: the messages of all channels in a third of a second.
_MAX_PENDING_MESSAGES = 256
#: Socket send buffer of a client [bytes].
_SEND_BUFFER_BYTES = 128 * 1024
#: Number of snapshots of which one is drawn, which makes 25 drawings a second.
_DRAW_EVERY = 2
#: Longest message from a client [bytes].
_MAX_MESSAGE_BYTES = 64 * 1024
#: Largest number of subscriptions of one client; also the largest number of clients.
_MAX_SUBSCRIPTIONS = 64
#: Bytes that the `websockets` library buffers for a client before sending waits.
_WRITE_BUFFER_BYTES = 32 * 1024

#: Separate logger, because the library would log a traceback for each connection that is no WebSocket, as in a scan.
_LOGGER = logging.getLogger(__name__)
_LOGGER.addFilter(lambda record: record.getMessage() != "opening handshake failed")


class FoxgloveServer:
    """Foxglove server; it runs in the event loop that opens it."""

    def __init__(
        self,
        robot: Robot,
        channels: Channels,
        tokens: Tokens | None,
        origins: Iterable[str],
        log: Callable[[str], None],
    ) -> None:
        """Prepare the server; `open` starts it.

        Args:
            robot, channels: the robot and its telemetry.
            tokens: access tokens, one of which every client needs; None: no token is required.
            origins: origins of web pages that may connect, in addition to `ALLOWED_ORIGINS`.
            log: takes the reason of a refusal, because a browser does not show it.
        """
        self._origins, self._log = ALLOWED_ORIGINS.union(origins), log
        self._drawing = Drawing(robot, channels.all, FIRST_DRAWING_CHANNEL)
        self._topics = (
            Topic(ROWS_TOPIC, "ros1", SCHEMA, "ros1msg", RowFormat(channels.all).definition),
            json_topic(EVENTS_TOPIC, EVENTS_SCHEMA),
            *self._drawing.topics,
        )
        self._tokens = tokens
        self._clients: set[_FoxgloveClient] = set()
        self._session = secrets.token_hex(8)
        self._count = 0
        self._info = StationInfo()
        self._event: tuple[int, bytes] | None = None  # time and text of the last event, for clients that connect later
        self._server: Server | None = None

    async def open(self, address: ListenAddress) -> ListenAddress:
        """Start listening and return the address.

        Raises:
            OSError: the port is not available.
        """
        family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        listening = socket.create_server((address.host, address.port), family=family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # inherited by every connection
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # inherited; no delay to join messages
        port = int(listening.getsockname()[1])
        # `Access` only checks the connections here; it passes none on to an application.
        access = Access(_no_endpoint, address.host, port, self._tokens, self._origins, ORIGIN_HINT)

        def check(connection: ServerConnection, request: Request) -> Response | None:
            refusal = access.refused(_scope_of(request))
            if refusal is None and len(self._clients) >= _MAX_SUBSCRIPTIONS:
                refusal = HTTPStatus.SERVICE_UNAVAILABLE, "too many clients are connected; disconnect one"
            if refusal is not None:
                self._log(f"Foxglove: a client is refused: {refusal[0]} {refusal[1]}")
            return None if refusal is None else connection.respond(HTTPStatus(refusal[0]), f"{refusal[1]}\n")

        self._server = await serve(
            self._serve, sock=listening, process_request=check, compression=None, max_size=_MAX_MESSAGE_BYTES,
            subprotocols=[Subprotocol(name) for name in SUBPROTOCOLS], write_limit=_WRITE_BUFFER_BYTES,
            logger=_LOGGER,
        )  # fmt: skip
        return ListenAddress(address.host, port)

    @property
    def needs_scene(self) -> bool:
        """Whether a client has subscribed to a drawing of the robot."""
        return any(channel >= FIRST_DRAWING_CHANNEL for client in self._clients for channel in client.channels)

    def publish(self, snapshot: Snapshot) -> None:
        """Queue the channels of a snapshot for the clients that have subscribed to them."""
        if snapshot.info != self._info:
            self._update_info(snapshot)
        self._count += 1
        for client in self._clients:
            for subscription in client.channels.get(ROWS_CHANNEL, ()):
                for row, stamp in zip(snapshot.rows, snapshot.stamps.tolist(), strict=True):
                    client.queue(message_data(subscription, stamp, row.astype("<f8").tobytes()))
        scene = snapshot.scene
        if scene is None or self._count % _DRAW_EVERY or not self.needs_scene:
            return
        for message in self._drawing.posed(scene.row, scene.pose, scene.stamp):
            self._queue(message.topic, message.time, message.data)

    async def close(self) -> None:
        """Disconnect all clients."""
        if self._server is not None:
            self._server.close()
            for client in tuple(self._clients):
                client.connection.transport.abort()

    def _update_info(self, snapshot: Snapshot) -> None:
        """Queue changes of the station's state as events, and of the controller's gains as parameters."""
        info, before = snapshot.info, self._info
        self._info = info
        if info.text != before.text:
            is_warning = info.state in (State.HOLD, State.FAULT)
            time = float(snapshot.rows[-1, 0]) if len(snapshot.rows) else 0.0
            stamp = int(snapshot.stamps[-1]) if len(snapshot.rows) else time_ns()
            self._event = (
                stamp,
                event_json(RecordedEvent(time, "state", info.text, WARNING if is_warning else INFO), stamp),
            )
            self._queue(EVENT_CHANNEL, *self._event)
        changed = set(info.gains) - set(before.gains)
        for client in self._clients:
            if changes := [(name, value) for name, value in changed if name in client.parameters]:
                client.queue(parameter_values(changes))

    def _queue(self, channel: int, stamp: int, data: bytes) -> None:
        for client in self._clients:
            for subscription in client.channels.get(channel, ()):
                client.queue(message_data(subscription, stamp, data))

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve a client that has passed the access checks, until the client disconnects."""
        client = _FoxgloveClient(connection)
        client.queue(server_info(self._session))
        client.queue(advertise(self._topics))
        self._clients.add(client)
        sending = asyncio.create_task(client.send())
        try:
            async for message in connection:
                self._handle(client, client_requests(message))
        except ConnectionClosed:
            return  # the client has disconnected
        finally:
            self._clients.discard(client)
            sending.cancel()

    def _handle(self, client: "_FoxgloveClient", request: dict[str, Any]) -> None:
        match request:
            case {"op": "subscribe", "subscriptions": [*subscriptions]}:
                for each in subscriptions:
                    if isinstance(each, dict):
                        self._subscribe(client, whole_numbers([each.get("id"), each.get("channelId")]))
            case {"op": "unsubscribe", "subscriptionIds": ids}:
                for number in whole_numbers(ids):
                    client.subscriptions.pop(number, None)
            case {"op": "getParameters", "parameterNames": names}:
                client.queue(parameter_values(self._gains(names), request.get("id")))
            case {"op": "setParameters"}:
                client.queue(status("the parameters are read-only; set them on the station's page"))
                client.queue(parameter_values(self._info.gains, request.get("id")))
            case {"op": "subscribeParameterUpdates", "parameterNames": names}:
                client.parameters |= {name for name, _ in self._gains(names)}
            case {"op": "unsubscribeParameterUpdates", "parameterNames": names}:
                client.parameters -= {name for name, _ in self._gains(names)}
            case _:
                return

    def _gains(self, names: Any) -> list[tuple[str, float | str | bool]]:
        """Return the named parameters of the controller; all of them if none is named."""
        named = string_list(names)
        return [gain for gain in self._info.gains if not named or gain[0] in named]

    def _subscribe(self, client: "_FoxgloveClient", numbers: list[int]) -> None:
        if len(numbers) != 2 or not 1 <= numbers[1] <= len(self._topics):
            client.queue(status("there is no channel with this id; subscribe to an id of the message 'advertise'"))
            return
        if len(client.subscriptions) >= _MAX_SUBSCRIPTIONS or numbers[0] in client.subscriptions:
            client.queue(status("the subscription id is in use, or there are too many subscriptions"))
            return
        client.subscriptions[numbers[0]] = numbers[1]
        if numbers[1] == EVENT_CHANNEL and self._event is not None:
            client.queue(message_data(numbers[0], *self._event))


class _FoxgloveClient:
    """A connected Foxglove client with its subscriptions and its message queue."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.subscriptions: dict[int, int] = {}  #: channel id of each subscription id
        self.parameters: set[str] = set()  #: names of the subscribed parameters
        self._messages: deque[str | bytes] = deque(maxlen=_MAX_PENDING_MESSAGES)
        self._ready = asyncio.Event()

    @property
    def channels(self) -> dict[int, list[int]]:
        """Subscription ids of each subscribed channel."""
        found: dict[int, list[int]] = {}
        for number, channel in self.subscriptions.items():
            found.setdefault(channel, []).append(number)
        return found

    def queue(self, message: str | bytes) -> None:
        """Queue a message for this client; never waits."""
        self._messages.append(message)
        self._ready.set()

    async def send(self) -> None:
        """Send queued messages until cancelled or until the client disconnects."""
        with contextlib.suppress(ConnectionClosed):
            while True:
                await self._ready.wait()
                self._ready.clear()
                while self._messages:
                    await self.connection.send(self._messages.popleft())


def _scope_of(request: Request) -> Scope:
    """Convert the opening request of a WebSocket to an ASGI scope, which the access checks need."""
    path, _, query = request.path.partition("?")
    headers = [(name.lower().encode("latin-1"), value.encode("latin-1")) for name, value in request.headers.raw_items()]
    return {"type": "websocket", "path": path, "query_string": query.encode("latin-1"), "headers": headers}


async def _no_endpoint(_scope: Scope, _receive: Receive, _send: Send) -> None:
    """Do nothing: placeholder for the application that `Access` requires; it is never called."""
