"""Limits on open connections, for each address and in total; the newest connection is always accepted.

A process has a limited number of file descriptors. If one client used all of them, no other client could connect and
send STOP. A new connection beyond the limit therefore closes an older one. The connection that was idle
longest is closed first, then connections with a request in progress, and last WebSockets. WebSockets, which stay open,
may use half of the connections.

viser, the server of the 3D scene, accepts every client on its loopback port, although only the station's proxy needs
access. This module makes viser refuse the pages of a browser, and limits the number of viser's connections.
"""

import asyncio
import contextlib
import select
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from websockets.asyncio import server
from websockets.asyncio.server import ServerConnection

#: Time within which a client must complete a request after it has connected, or after the previous answer [s].
REQUEST_TIMEOUT_S = 20.0
#: Largest number of open connections from all clients, if the system provides enough file descriptors.
MAX_CONNECTIONS = 256
#: Number of file descriptors reserved for libraries, pipes, files and the scene's server.
RESERVED_DESCRIPTORS = 256
#: Event by which `poll` reports that a client has closed its socket (Linux only; 0 on other systems).
HUNG_UP = getattr(select, "POLLRDHUP", 0)
ENDING = "the station is ending"
#: Close code by which a server requests a WebSocket client to connect again later.
TRY_AGAIN_LATER = 1013

Address = tuple[str, int]


def connection_capacity() -> int:
    """Return the number of connections for which the file descriptors of this process suffice."""
    try:
        import resource  # not on Windows
    except ImportError:
        return MAX_CONNECTIONS
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return (
        MAX_CONNECTIONS
        if limit == resource.RLIM_INFINITY
        else max(16, min(MAX_CONNECTIONS, (limit - RESERVED_DESCRIPTORS) // 2))
    )


@dataclass(eq=False)
class _Connection:
    """An open connection of a client to the server."""

    transport: asyncio.Transport
    address: Address
    since: float  #: time when the connection was opened, or when its last answer was sent [s]
    answering: int = 0  #: number of complete requests that are being answered
    socket: bool = False  #: whether the connection is a WebSocket

    @property
    def closed(self) -> bool:
        """Whether the connection's file descriptor is free; a connection that is closing still uses its descriptor."""
        return self.transport.get_extra_info("socket").fileno() < 0

    def gone(self) -> bool:
        """Return whether the client has disconnected, even if the server has not noticed it yet. Thread-safe."""
        if self.transport.is_closing() or self.closed:
            return True
        if not HUNG_UP:
            return False
        poll = select.poll()
        poll.register(self.transport.get_extra_info("socket").fileno(), HUNG_UP)
        return bool(poll.poll(0))


class Connections:
    """Middleware that bounds the open connections to the wrapped application."""

    def __init__(self, app: ASGIApp, total: int, each: int | None = None, timeout: float = REQUEST_TIMEOUT_S) -> None:
        """Wrap `app`.

        Args:
            app: the wrapped application.
            total: largest number of open connections.
            each: largest number of open connections from one address; None: half of `total`.
            timeout: time within which a client must complete a request [s].
        """
        self._app, self._total, self._each, self._timeout = app, total, each or max(1, total // 2), timeout
        self._open: dict[Address, _Connection] = {}
        self._ended = False

    def admitting(self, protocol: Callable[..., Any]) -> Callable[..., "_ConnectionLimit"]:
        """Return a factory for the server's protocol objects; each object first passes its connection to `admit`."""
        return lambda **options: _ConnectionLimit(protocol(**options), self.admit)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request. If the server's shutdown cancels the request, the client still gets an answer."""
        started = False

        async def send_noted(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._dispatch(scope, receive, send_noted)
        except asyncio.CancelledError:
            if not self._ended:
                raise
            if not started:
                await _answer_cancelled(scope, send)

    async def _dispatch(self, scope: Scope, receive: Receive, send: Send) -> None:
        host, port = scope.get("client") or ("", 0)
        connection = self._open.get((host, port))
        if connection is None:
            await self._app(scope, receive, send)
            return
        scope.setdefault("state", {})["gone"] = connection.gone
        if scope["type"] == "websocket":
            await self._socket(connection, scope, receive, send)
        else:
            await self._request(connection, scope, receive, send)

    def end(self) -> None:
        """Prepare the server's shutdown: close idle connections, and let pending requests be answered."""
        self._ended = True
        for known in self._open.values():
            if not known.answering and not known.socket:
                known.transport.abort()

    def admit(self, transport: asyncio.Transport) -> None:
        """Add a new connection; first close an older connection if the limit is reached."""
        peer = transport.get_extra_info("peername")
        if not peer:
            return  # the client has closed the connection already
        for address in [address for address, known in self._open.items() if known.closed]:
            del self._open[address]
        loop = asyncio.get_running_loop()
        new = _Connection(transport, (str(peer[0]), int(peer[1])), loop.time())
        neighbours = [known for known in self._open.values() if known.address[0] == new.address[0]]
        if len(neighbours) >= self._each:
            self._close_one_of(neighbours)
        elif len(self._open) >= self._total:
            self._close_one_of(list(self._open.values()))
        self._open[new.address] = new
        loop.call_later(self._timeout, self._close_idle, new)

    def _close_one_of(self, candidates: list[_Connection]) -> None:
        victim = min(candidates, key=lambda known: (known.socket, known.answering > 0, known.since))
        victim.transport.abort()
        self._open.pop(victim.address, None)

    def _close_idle(self, connection: _Connection) -> None:
        """Close a connection that has sent no complete request in time."""
        if connection.closed:
            if self._open.get(connection.address) is connection:
                del self._open[connection.address]
            return
        loop = asyncio.get_running_loop()
        if connection.answering or connection.socket:
            loop.call_later(self._timeout, self._close_idle, connection)
        elif (left := connection.since + self._timeout - loop.time()) > 0.0:
            loop.call_later(left, self._close_idle, connection)
        else:
            connection.transport.abort()
            self._open.pop(connection.address, None)

    async def _socket(self, connection: _Connection, scope: Scope, receive: Receive, send: Send) -> None:
        sockets = [known.address[0] for known in self._open.values() if known.socket and not known.closed]
        if len(sockets) >= self._total // 2 or sockets.count(connection.address[0]) >= self._each // 2:
            await send({"type": "websocket.close", "code": TRY_AGAIN_LATER, "reason": "too many WebSockets are open"})
            return
        connection.socket = True
        await self._app(scope, receive, send)

    async def _request(self, connection: _Connection, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        complete = headers.get("content-length", "0") == "0" and "transfer-encoding" not in headers
        connection.answering += complete

        async def receive_noted() -> Message:
            nonlocal complete
            message = await receive()
            if not complete and not message.get("more_body", False):
                complete = True
                connection.answering += 1
            return message

        try:
            await self._app(scope, receive_noted, send)
        finally:
            connection.answering -= complete
            connection.since = asyncio.get_running_loop().time()


async def _answer_cancelled(scope: Scope, send: Send) -> None:
    """Answer a request that the server's shutdown has cancelled."""
    with contextlib.suppress(Exception):  # the client may have disconnected
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1012, "reason": ENDING})
        elif scope["type"] == "http":
            await JSONResponse({"error": ENDING}, 503)(scope, _disconnected, send)


async def _disconnected() -> Message:
    return {"type": "http.disconnect"}


class _ConnectionLimit:
    """Wrapper of the server's protocol object for one connection; it first passes the connection to `admit`."""

    def __init__(self, inside: Any, admit: Callable[[asyncio.Transport], None]) -> None:
        self._inside, self._admit = inside, admit

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Admit the connection, then pass the event on."""
        self._admit(transport)
        self._inside.connection_made(transport)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the wrapped protocol object."""
        return getattr(self._inside, name)


@contextmanager
def limited_scene_server(most: int) -> Iterator[None]:
    """Provide a context in which a new viser server accepts at most `most` connections, and no connection from a page.

    viser has no settings for these limits, so the context changes the `websockets` server that viser uses.
    """
    plain, open_ = server.serve, list[_Guarded]()
    changed = cast("Any", server)
    # `origins=[None]` refuses browsers, which send an Origin header; the proxy sends none.
    guarded = cast("Any", partial(_Guarded, open_, most))
    changed.serve = partial(plain, origins=[None], create_connection=guarded)
    try:
        yield
    finally:
        changed.serve = plain


class _Guarded(ServerConnection):
    """Connection to viser that counts toward the limit."""

    def __init__(self, open_: "list[_Guarded]", most: int, *args: Any, **options: Any) -> None:
        """`open_` lists the open connections, oldest first; `most` is the largest number of open connections."""
        super().__init__(*args, **options)
        self._open, self._most = open_, most

    def connection_made(self, transport: Any) -> None:
        """Add this connection; at the limit, first close the oldest one without a request, or else the oldest one."""
        super().connection_made(transport)
        if len(self._open) >= self._most:
            victim = min(self._open, key=lambda known: known.request is not None)
            self._open.remove(victim)
            victim.transport.abort()
        self._open.append(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the list."""
        if self in self._open:
            self._open.remove(self)
        super().connection_lost(exc)
