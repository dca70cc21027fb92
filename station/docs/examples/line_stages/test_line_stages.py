"""The installed stages keep every requirement of the control loop, and exchange lines with a real socket."""

import socket
import time

import numpy as np
import pytest

from station.config.robots import load_robot
from station.devices.driver_check.stages import check_stages
from station.devices.interfaces import Condition, NotStopped
from station.devices.registry import emergency_stop, find
from station.lab.wires import HostPort

ROBOT = load_robot("paper")
OPTIONS = {"host": "box", "port": 1}


class Box:
    """Simulated box, which is also the virtual clock: it accelerates the axes, and sends 100 lines a second."""

    def __init__(self) -> None:
        self.positions, self._velocities, self._commanded = np.array([0.1, 1.5, -0.1]), np.zeros(3), np.zeros(3)
        self._time, self._ramps = 0.0, np.array([joint.acceleration for joint in ROBOT.joints])
        self.port = HostPort("box")

    def open(self, url: str, baud: int) -> HostPort:
        self.port.reopen()
        return self.port

    def now(self) -> float:
        return self._time

    def sleep(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.001)):
            self._time = round(self._time + 0.001, 6)
            for line in self.port.device.read().decode().splitlines():
                self.receive(line)
            self.advance(0.001)
            if round(self._time / 0.001) % 10 == 0:
                self.send()

    def receive(self, line: str) -> None:
        self._commanded = np.zeros(3) if line == "stop" else np.array(line.split(), float)
        if line == "stop":
            self.port.device.write(b"stopped\n")

    def advance(self, seconds: float) -> None:
        most = self._ramps * seconds
        self._velocities = self._velocities + np.clip(self._commanded - self._velocities, -most, most)
        self.positions = self.positions + self._velocities * seconds

    def send(self) -> None:
        self.port.device.write((" ".join(f"{q:.9f}" for q in self.positions) + "\n").encode())


@pytest.fixture
def box(monkeypatch):
    box = Box()
    monkeypatch.setattr("line_stages.SerialLink", box.open)
    return box


def test_the_driver_keeps_the_contract_of_the_control_loop(box):
    opens = find("stages", "line-stages")(OPTIONS, ROBOT)
    stop = emergency_stop({"driver": "line-stages", **OPTIONS}, ROBOT)
    assert [finding for finding in check_stages(opens, ROBOT.joints, box, stop, True) if not finding.good] == []


def test_silence_and_a_wrong_line_cause_a_fault_until_the_stages_are_connected_again(box):
    stages = find("stages", "line-stages")(OPTIONS, ROBOT)()
    for wrong in (b"", b"0.1 nan -0.1\n", b"0.1 1.5\n"):
        stages.connect(box.now())
        box.sleep(0.02)
        stages.poll(box.now())
        assert stages.ready
        box.port.device.write(wrong)
        stages.poll(box.now() + (0.0 if wrong else 0.2))
        assert stages.condition is Condition.FAULT
        assert stages.trouble(box.now()) is not None


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def test_velocities_are_sent_and_positions_are_read_by_tcp(server):
    stages = find("stages", "line-stages")({"host": "127.0.0.1", "port": server.getsockname()[1]}, ROBOT)()
    stages.connect(0.0)
    with server.accept()[0] as box:
        assert box.recv(100) == b"0 0 0\n"
        box.sendall(b"0.1 1.5 -0.1\n")
        end = time.monotonic() + 5.0
        while not stages.ready and time.monotonic() < end:
            stages.poll(0.0)
            time.sleep(0.002)
        assert stages.poll(0.0).positions == pytest.approx([0.1, 1.5, -0.1])
        stages.command(np.array([0.2, 0.0, -0.01]), 0.0)
        assert box.recv(100) == b"0.2 0 -0.01\n"
    stages.close()


@pytest.mark.parametrize("confirms", [True, False])
def test_emergency_stop_reports_a_stop_only_after_the_box_has_confirmed_it(box, monkeypatch, confirms: bool):
    monkeypatch.setattr(box, "receive", box.receive if confirms else lambda line: None)
    stop = emergency_stop({"driver": "line-stages", **OPTIONS}, ROBOT)
    if confirms:
        assert "report that they have stopped" in stop(box)
    else:
        with pytest.raises(NotStopped, match="press the emergency stop"):
            stop(box)
