"""Idle connections do not block connections with requests."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import NamedTuple

import httpx
import pytest
import uvicorn
from starlette.types import Receive, Scope, Send
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.harness.waiting import NET, until
from web.access.connections import Connections

asked: list[str] = []  #: requests that wait for the slow answer


async def application(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer complete bodies; keep WebSockets until the client disconnects; /slow waits for the disconnect."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
    while not (message := await receive())["type"].endswith("disconnect"):
        if message["type"] == "http.request" and not message.get("more_body"):
            break
    if scope["type"] == "http":
        if scope["path"] == "/slow":
            asked.append(scope["path"])
            await receive()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"ok"})


class Doors(NamedTuple):
    """A server's address, and the number of its open connections."""

    port: int
    open: Callable[[], int]

    def idle(self, opened: ExitStack) -> socket.socket:
        return opened.enter_context(socket.create_connection(("127.0.0.1", self.port)))

    def ask(self) -> int:
        return httpx.get(f"http://127.0.0.1:{self.port}/", timeout=NET, trust_env=False).status_code


@pytest.fixture
def serve() -> Iterator[Callable[..., Doors]]:
    with ExitStack() as ends:

        def start(most: int, each: int, patience: float) -> Doors:
            listening = socket.create_server(("127.0.0.1", 0))
            connections = Connections(application, most, each, patience)
            settings = uvicorn.Config(connections, log_level="critical", lifespan="off", timeout_graceful_shutdown=0)
            settings.load()
            settings.http_protocol_class = connections.admitting(settings.http_protocol_class)
            server = uvicorn.Server(settings)
            thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
            thread.start()
            ends.callback(thread.join)
            ends.callback(setattr, server, "should_exit", True)
            until(lambda: server.started)
            return Doors(listening.getsockname()[1], lambda: len(server.server_state.connections))

        yield start


def test_a_request_is_accepted_despite_idle_connections(serve: Callable[..., Doors]) -> None:
    doors = serve(most=16, each=8, patience=NET)
    with ExitStack() as opened:
        for _ in range(100):
            doors.idle(opened)
        assert doors.ask() == 200
        until(lambda: doors.open() <= 8)


def test_a_connection_waiting_for_its_answer_outlasts_idle_connections(serve: Callable[..., Doors]) -> None:
    doors = serve(most=16, each=8, patience=0.2)
    with ExitStack() as opened:
        slow = doors.idle(opened)
        slow.sendall(b"GET /slow HTTP/1.1\r\nhost: x\r\n\r\n")
        until(lambda: asked == ["/slow"])
        half = doors.idle(opened)
        half.sendall(b"POST / HTTP/1.1\r\nhost: x\r\ncontent-length: 100\r\n\r\nhalf")
        silent = [doors.idle(opened) for _ in range(50)]
        assert all(_closed(connection) for connection in (half, *silent))
        slow.setblocking(False)
        with pytest.raises(BlockingIOError):
            slow.recv(1)
        slow.setblocking(True)
        slow.shutdown(socket.SHUT_WR)


def test_websockets_leave_connections_for_requests(serve: Callable[..., Doors]) -> None:
    doors = serve(most=16, each=8, patience=NET)
    with ExitStack() as opened:
        for _ in range(4):
            opened.enter_context(connect(f"ws://127.0.0.1:{doors.port}/", proxy=None))
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{doors.port}/", proxy=None)
        assert doors.ask() == 200


def _closed(connection: socket.socket) -> bool:
    """Wait until the server closes a connection; return whether it did."""
    connection.settimeout(NET)
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True
