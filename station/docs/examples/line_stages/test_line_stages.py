"""The installed stages send velocities, read positions, and stop every axis after a crash."""

import socket
import threading
import time

import numpy as np
import pytest

from station.config.robots import load_robot
from station.control.clock import REAL_TIME_CLOCK
from station.devices.interfaces import NotStopped
from station.devices.registry import emergency_stop, find

ROBOT = load_robot("paper")


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def options(server: socket.socket) -> dict[str, object]:
    return {"host": "127.0.0.1", "port": server.getsockname()[1]}


def test_velocities_are_sent_and_positions_are_read(server):
    stages = find("stages", "line-stages")(options(server), ROBOT)()
    stages.connect(0.0)
    with server.accept()[0] as box:
        box.sendall(b"0.1 1.5 -0.1\n")
        end = time.monotonic() + 5.0
        while not stages.ready and time.monotonic() < end:
            stages.poll(1.0)
            time.sleep(0.002)
        assert stages.poll(1.0).positions == pytest.approx([0.1, 1.5, -0.1])
        stages.command(np.array([0.2, 0.0, -0.01]), 1.0)
        assert box.recv(100) == b"0.2 0 -0.01\n"
        stages.stop(1.0)
        assert box.recv(100) == b"0 0 0\n"
    stages.close()


@pytest.mark.parametrize("confirms", [True, False])
def test_emergency_stop_reports_a_stop_only_after_the_box_has_confirmed_it(server, confirms: bool):
    stop = emergency_stop({"driver": "line-stages", **options(server)}, ROBOT)
    results: list[object] = []

    def attempt() -> None:
        try:
            results.append(stop(REAL_TIME_CLOCK))
        except NotStopped as error:
            results.append(error)

    stopping = threading.Thread(target=attempt)
    stopping.start()
    with server.accept()[0] as box:
        assert box.recv(100) == b"stop\n"
        box.sendall(b"0 0 0\n" + b"stopped\n" * confirms)
        stopping.join()
    assert isinstance(results[0], str) is confirms
