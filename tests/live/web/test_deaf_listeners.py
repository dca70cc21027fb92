"""A thousand programs that request telemetry and never read it: the station moves, stops and its memory is bounded."""

import base64
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import psutil
import pytest

from tests.harness.serving import Served, serving

LISTENERS = 1000
#: Largest growth of the station's memory for all clients together [bytes]; a row for one client has about 3 kB.
ROOM = 200e6
FREE = {"trajectory": {"kind": "circle", "radius": 0.002, "period": 20.0}, "duration": 600.0}


@pytest.fixture
def served() -> Iterator[Served]:
    with serving(rate=0.1) as served:  # the clock is slow, so that a timeout of 1 s lasts 10 s of real time
        yield served


def deaf(port: int, number: int, opened: ExitStack) -> socket.socket:
    """Connect from one of 20 addresses with default buffers, request 100 rows per second, and read nothing."""
    listener = socket.create_connection(("127.0.0.1", port), source_address=(f"127.0.1.{1 + number % 20}", 0))
    opened.enter_context(listener)
    key = base64.b64encode(os.urandom(16)).decode()
    listener.sendall(
        f"GET /api/telemetry?rate=100 HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return listener


def test_a_thousand_telemetry_clients_that_do_not_read_delay_no_other_client(served: Served):
    served.ready()
    station = psutil.Process(served.process.pid)
    before = station.memory_info().rss
    assert served.post("/api/start", FREE).status_code == 202
    served.wait_for(lambda status: status["phase"] == "moving")
    with ExitStack() as opened:
        for number in range(LISTENERS):
            deaf(served.port, number, opened)
        ticks = served.status()["loop"]["ticks"]
        # After so many rows all buffers of the clients that do not read are full.
        status = served.wait_for(lambda status: status["loop"]["ticks"] > ticks + 1_500)
        assert (status["state"], status["phase"]) == ("RUNNING", "moving"), status["cause"]
        assert station.num_fds() < LISTENERS
        grown = station.memory_info().rss - before
        assert grown < ROOM, f"{1e-6 * grown:.0f} MB"
        assert served.post("/api/stop").json()["state"] == "STOPPED"
    served.ready()
