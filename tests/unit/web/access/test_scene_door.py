"""viser's own port, reached past the station's."""

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
from web.access.scene_door import guarded_scene

MOST = 8


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with guarded_scene(MOST):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.get_port()
    server.stop()


def knock(port: int, origin: Origin | None = None) -> ClientConnection:
    return connect(
        f"ws://127.0.0.1:{port}/", origin=origin, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], proxy=None
    )


def closed(connection: socket.socket) -> bool:
    """By the other end; waits for it."""
    connection.settimeout(NET)
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


def test_a_page_of_another_site_is_refused_and_the_proxy_is_not(port: int) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        knock(port, Origin("http://evil.example"))
    with knock(port) as proxy:
        assert proxy.recv()


def test_silent_connections_are_bounded_and_give_way_to_those_that_ask(port: int) -> None:
    with ExitStack() as opened, knock(port) as proxy:
        silent = [opened.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(50)]
        assert all(closed(connection) for connection in silent[: -MOST + 1])
        assert httpx.get(f"http://127.0.0.1:{port}/", trust_env=False, timeout=NET).status_code == 200
        assert proxy.recv()


def test_connections_that_all_ask_are_bounded_too_and_their_places_are_free_again(port: int) -> None:
    with ExitStack() as opened:
        asking = [opened.enter_context(knock(port)) for _ in range(3 * MOST)]
        assert until(lambda: sum(connection.state is State.OPEN for connection in asking) <= MOST)
        assert asking[-1].recv()
    with knock(port) as proxy:
        assert proxy.recv()
