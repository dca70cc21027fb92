"""The installed tracker is found by its name and reads frames from a real socket."""

import math
import socket
import threading
import time

import pytest

from station.config.robots import load_robot
from station.control.clock import REAL_TIME_CLOCK
from station.devices.driver_check.samples import check_tracker
from station.devices.interfaces import Condition, Severity, TipReading
from station.devices.registry import find


def frame(tracker, now: float) -> TipReading:
    """Return the next frame; fail after 5 s."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        if (reading := tracker.poll(now)) is not None:
            return reading
        time.sleep(0.002)
    raise AssertionError("no frame has arrived")


def test_frames_arrive_in_metres_at_the_time_of_their_measurement():
    with socket.create_server(("127.0.0.1", 0)) as server:
        options = {"host": "127.0.0.1", "port": server.getsockname()[1], "latency": 0.024}
        tracker = find("tracker", "line-tracker")(options, load_robot("paper"))()
        tracker.connect(0.0)
        with server.accept()[0] as device:
            device.sendall(b"nonsense\n1 10.0 -20.0 150.5\n")
            reading = frame(tracker, 1.0)
        assert reading.time == pytest.approx(0.976)
        assert reading.position == pytest.approx([0.010, -0.020, 0.1505])
        assert tracker.condition is Condition.CONNECTED
        assert tracker.trouble(2.0).severity is Severity.HOLD  # no frame for a second
        tracker.close()


def test_a_late_line_gets_the_time_of_its_measurement_and_the_mount_turns_its_position():
    mount = {"position": [0.0, 0.0, 0.1], "rotation_vector": [0.0, 0.0, math.pi / 2]}
    with socket.create_server(("127.0.0.1", 0)) as server:
        options = {"host": "127.0.0.1", "port": server.getsockname()[1], "rate": 40.0, "mount": mount}
        tracker = find("tracker", "line-tracker")(options, load_robot("paper"))()
        tracker.connect(0.0)
        with server.accept()[0] as device:
            device.sendall(b"1 10.0 0.0 0.0\n")
            first = frame(tracker, 1.0)
            device.sendall(b"2 10.0 0.0 0.0\n")
            late = frame(tracker, 1.125)  # 0.1 s later than a quick line
        assert late.time - first.time == pytest.approx(0.025, abs=1e-3)
        assert late.position == pytest.approx([0.0, 0.010, 0.1])
        tracker.close()


def test_the_driver_keeps_the_contract_of_the_control_loop():
    over = threading.Event()

    def send(server: socket.socket) -> None:
        with server.accept()[0] as device:
            number = 0
            while not over.wait(0.025):
                number += 1
                device.sendall(f"{number} 10.0 -20.0 150.5\n".encode())

    with socket.create_server(("127.0.0.1", 0)) as server:
        options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
        sender = threading.Thread(target=send, args=(server,))
        sender.start()
        try:
            opens = find("tracker", "line-tracker")(options, load_robot("paper"))
            assert [finding for finding in check_tracker(opens, REAL_TIME_CLOCK) if not finding.good] == []
        finally:
            over.set()
            sender.join()
