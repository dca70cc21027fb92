"""Direct access to viser's port, without the station's port in between."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack

import httpx
import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.protocol import State
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from tests.harness.waiting import NET, until
from web.access.connections import limited_scene_server

MOST = 8


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with limited_scene_server(MOST):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.get_port()
    server.stop()


def knock(port: int, origin: Origin | None = None) -> ClientConnection:
    return connect(
        f"ws://127.0.0.1:{port}/", origin=origin, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], proxy=None
    )


def closed(connection: socket.socket) -> bool:
    """Wait until the server closes a connection; return whether it did."""
    connection.settimeout(NET)
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def test_the_port_of_viser_refuses_a_page_of_another_site_and_accepts_the_proxy(port: int) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        knock(port, Origin("http://evil.example"))
    with knock(port) as proxy:
        assert proxy.recv()


def test_idle_viser_connections_are_bounded_and_closed_before_those_with_requests(port: int) -> None:
    with ExitStack() as opened, knock(port) as proxy:
        silent = [opened.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(50)]
        assert all(closed(connection) for connection in silent[: -MOST + 1])
        assert httpx.get(f"http://127.0.0.1:{port}/", trust_env=False, timeout=NET).status_code == 200
        assert proxy.recv()


def test_viser_connections_with_requests_are_bounded_and_become_free_again(port: int) -> None:
    with ExitStack() as opened:
        asking = [opened.enter_context(knock(port)) for _ in range(3 * MOST)]
        assert until(lambda: sum(connection.state is State.OPEN for connection in asking) <= MOST)
        assert asking[-1].recv()
    with knock(port) as proxy:
        assert proxy.recv()
