"""How many connections are open: bounded for each address and in all, and the newest is always let in.

A process has so many descriptors and no more; whoever takes them all would keep STOP out, and the station from
stopping its stages. So a connection that is too many costs an older one its place: first one that has asked for
nothing, the longest silent before the others. Websockets, which stay, may take half of the places.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: A request has to be whole so long after its connection was opened, or after the answer before it [s].
PATIENCE = 20.0
#: Connections in all, where the system gives descriptors enough.
MOST = 256
#: Descriptors that are not for connections: libraries, pipes, files, the scene's own server.
OTHERS = 256
#: "Try again later", of a websocket.
BUSY = 1013

Address = tuple[str, int]


def places() -> int:
    """How many connections this process has descriptors for; one through the scene's proxy takes three."""
    try:
        import resource  # not on Windows
    except ImportError:
        return MOST
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MOST if limit == resource.RLIM_INFINITY else max(16, min(MOST, (limit - OTHERS) // 2))


@dataclass(eq=False)
class _Connection:
    """One that is open."""

    transport: asyncio.Transport
    address: Address
    since: float  #: when it was opened, or had its last answer [s]
    answering: int = 0  #: whole requests whose answer is under way
    socket: bool = False  #: a websocket

    @property
    def closed(self) -> bool:
        """Whether its descriptor is free again; one that is being closed may still have to be read from."""
        return self.transport.get_extra_info("socket").fileno() < 0


class Connections:
    """The application inside, and the connections through which it is asked."""

    def __init__(self, app: ASGIApp, most: int, each: int | None = None, patience: float = PATIENCE) -> None:
        """At most so many connections in all, and from each address (half of them if not told)."""
        self._app, self._most, self._each, self._patience = app, most, each or max(1, most // 2), patience
        self._open: dict[Address, _Connection] = {}

    def admitting(self, protocol: Callable[..., Any]) -> Callable[..., "_Door"]:
        """That makes a server's protocols, with a look at every new connection."""
        return lambda **told: _Door(protocol(**told), self.admit)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Carry out a request, and remember that its sender waits for an answer."""
        host, port = scope.get("client") or ("", 0)
        connection = self._open.get((host, port))
        if connection is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._socket(connection, scope, receive, send)
        else:
            await self._request(connection, scope, receive, send)

    def end(self) -> None:
        """The server ends: it waits for answers that are under way, and not for what has not been asked yet."""
        for known in self._open.values():
            if not known.answering and not known.socket:
                known.transport.abort()

    def admit(self, transport: asyncio.Transport) -> None:
        """A new connection: if it is one too many, an older one goes."""
        peer = transport.get_extra_info("peername")
        if not peer:
            return  # it has gone already
        for address in [address for address, known in self._open.items() if known.closed]:
            del self._open[address]
        loop = asyncio.get_running_loop()
        new = _Connection(transport, (str(peer[0]), int(peer[1])), loop.time())
        neighbours = [known for known in self._open.values() if known.address[0] == new.address[0]]
        if len(neighbours) >= self._each:
            self._make_room(neighbours)
        elif len(self._open) >= self._most:
            self._make_room(list(self._open.values()))
        self._open[new.address] = new
        loop.call_later(self._patience, self._look, new)

    def _make_room(self, among: list[_Connection]) -> None:
        last = min(among, key=lambda known: (known.socket, known.answering > 0, known.since))
        last.transport.abort()
        self._open.pop(last.address, None)

    def _look(self, connection: _Connection) -> None:
        """Close one that asks for nothing."""
        if connection.closed:
            if self._open.get(connection.address) is connection:
                del self._open[connection.address]
            return
        loop = asyncio.get_running_loop()
        if connection.answering or connection.socket:
            loop.call_later(self._patience, self._look, connection)
        elif (left := connection.since + self._patience - loop.time()) > 0.0:
            loop.call_later(left, self._look, connection)
        else:
            connection.transport.abort()
            self._open.pop(connection.address, None)

    async def _socket(self, connection: _Connection, scope: Scope, receive: Receive, send: Send) -> None:
        sockets = [known.address[0] for known in self._open.values() if known.socket and not known.closed]
        if len(sockets) >= self._most // 2 or sockets.count(connection.address[0]) >= self._each // 2:
            await send({"type": "websocket.close", "code": BUSY, "reason": "too many websockets are open"})
            return
        connection.socket = True
        await self._app(scope, receive, send)

    async def _request(self, connection: _Connection, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        whole = headers.get("content-length", "0") == "0" and "transfer-encoding" not in headers
        connection.answering += whole

        async def heard() -> Message:
            nonlocal whole
            message = await receive()
            if not whole and not message.get("more_body", False):
                whole = True
                connection.answering += 1
            return message

        try:
            await self._app(scope, heard, send)
        finally:
            connection.answering -= whole
            connection.since = asyncio.get_running_loop().time()


class _Door:
    """A server's protocol of one connection, once that has been admitted."""

    def __init__(self, inside: Any, admit: Callable[[asyncio.Transport], None]) -> None:
        self._inside, self._admit = inside, admit

    def connection_made(self, transport: asyncio.Transport) -> None:
        """The first word of the loop about a connection."""
        self._admit(transport)
        self._inside.connection_made(transport)

    def __getattr__(self, name: str) -> Any:
        """Everything else is the protocol's."""
        return getattr(self._inside, name)
