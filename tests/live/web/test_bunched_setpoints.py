"""A live station accepts setpoints that arrive in bunches, or faster than it reads them."""

import json
import socket
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Self

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from core.robot.robot import Array
from station.config.robots import load_robot
from station.control.process import ring_width
from station.control.ring import Ring
from station.control.telemetry import Channels
from tests.harness.serving import Served, shared_memory
from tests.harness.waiting import until

WIDE = {"silence": 2.0, "end": 20.0}  # the station's clock is slow and the computer busy


@contextmanager
def leading(station: Served, **asked: float) -> Iterator[ClientConnection]:
    """Yield a client with a setpoint stream; the client reads answers only when the test calls `recv`."""
    with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None, max_queue=None) as client:
        client.send(json.dumps({**WIDE, **asked}))
        assert "run_id" in json.loads(client.recv())
        assert json.loads(client.recv()).get("ready")
        yield client


def send_together(client: ClientConnection, messages: Sequence[str]) -> None:
    """Send messages that arrive at once, as those that have waited while the station was busy."""
    with client.protocol_mutex:
        for message in messages:
            client.protocol.send_text(message.encode())
        client.socket.sendall(b"".join(client.protocol.data_to_send()))


class Watched:
    """Rows of the control loop since its start."""

    def __init__(self, station: Served) -> None:
        control = station.control_process().pid
        (path,) = [path for path in shared_memory(control) if f"_{station.process.pid}_" in path.name]
        robot = load_robot("paper")
        self.ring, self._channels = Ring(ring_width(robot), path.name), Channels(robot.robot())
        resource_tracker.unregister(f"/{path.name}", "shared_memory")  # the station removes the shared memory
        self._since, self._rows = self.ring.written, list[Array]()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.ring.close(remove=False)

    def __call__(self, group: str) -> Array:
        rows, self._since, _ = self.ring.read(self._since)
        self._rows.append(rows)
        return self._channels.of(np.concatenate(self._rows), group)


def test_station_follows_only_the_newest_of_setpoints_that_arrive_at_once_and_refuses_none(station: Served) -> None:
    with leading(station) as client, Watched(station) as watched:
        client.send('{"tip": [0, 0, 0]}')
        assert json.loads(client.recv()).get("refused") == ""
        places = [1e-5 * k for k in range(300)] + [1e-3]
        send_together(client, [json.dumps({"tip": [0.0, 1e-3, place]}) for place in places])
        answers = [json.loads(client.recv()) for _ in places]
        assert [one.get("refused", one) for one in answers] == [""] * len(places)

        def requested() -> Array:
            kinds = watched("request_kind")[:, 0]
            return watched("request")[: len(kinds)][kinds == 1.0]

        def followed() -> Array:
            """Return how far along the tubes the places after the first one are [m]."""
            moved = requested() - requested()[0]
            return moved[moved[:, 1] > 5e-4, 2]

        until(lambda: followed().size > 0)
        assert followed() == pytest.approx(1e-3, abs=1e-6)
        client.send('{"end": true}')


def test_a_setpoint_client_that_resets_its_connection_is_in_the_audit_log(station: Served) -> None:
    name = {"x-ctr-client": "reset-0123456789", "x-ctr-name": "reset"}
    client = connect(f"ws://127.0.0.1:{station.port}/api/setpoints", additional_headers=name, proxy=None)
    client.send(json.dumps(WIDE))
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.socket.close()

    def log(outcome: str) -> list[str]:
        entries = station.rest.get("/api/log").json()
        return [
            one["who"] for one in entries if one["what"].startswith("setpoints of run") and one["outcome"] == outcome
        ]

    until(lambda: any("reset" in who for who in log("ended")))
    assert any("reset" in who for who in log("started"))
    station.wait_for(lambda status: status["state"] == "READY")
    station.rest.delete("/api/operator", headers=name)
