"""A thousand programs that ask for telemetry and never read it: the station moves, stops and does not grow."""

import base64
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import psutil
import pytest

from tests.harness.serving import Served, serving

LISTENERS = 1000
#: What a station may grow by for all of them together [bytes]; a row of each is some 3 kB.
ROOM = 200e6
FREE = {"trajectory": {"kind": "circle", "radius": 0.002, "period": 20.0}, "duration": 600.0}


@pytest.fixture
def served() -> Iterator[Served]:
    with serving(rate=0.1) as served:  # what has to be heard within a second gets ten
        yield served


def deaf(port: int, number: int, opened: ExitStack) -> socket.socket:
    """One that asks for a hundred rows a second, from one of many addresses, and reads nothing; buffers as they are."""
    listener = socket.create_connection(("127.0.0.1", port), source_address=(f"127.0.1.{1 + number % 20}", 0))
    opened.enter_context(listener)
    key = base64.b64encode(os.urandom(16)).decode()
    listener.sendall(
        f"GET /api/telemetry?rate=100 HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return listener


def test_a_thousand_listeners_that_do_not_read_keep_nobody_from_anything(served: Served):
    served.ready()
    station = psutil.Process(served.process.pid)
    before = station.memory_info().rss
    assert served.post("/api/start", FREE).status_code == 202
    served.wait_for(lambda status: status["phase"] == "moving")
    with ExitStack() as opened:
        for number in range(LISTENERS):
            deaf(served.port, number, opened)
        ticks = served.status()["loop"]["ticks"]
        # So many rows that those who read nothing have all their buffers full.
        status = served.wait_for(lambda status: status["loop"]["ticks"] > ticks + 1_500)
        assert (status["state"], status["phase"]) == ("RUNNING", "moving"), status["cause"]
        assert station.num_fds() < LISTENERS
        grown = station.memory_info().rss - before
        assert grown < ROOM, f"{1e-6 * grown:.0f} MB"
        assert served.post("/api/stop").json()["state"] == "STOPPED"
    served.ready()
