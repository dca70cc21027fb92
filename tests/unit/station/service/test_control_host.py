"""What the station process does about a control process that ends, played here by a pipe."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import pytest

from station.config.robots import RobotFile
from station.control.process import ring_width
from station.control.ring import HEARTBEAT, Ring
from station.devices.config import BenchFile
from station.service import control_host
from station.service.control_host import ControlHost
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES
from tests.harness.waiting import NET


class Played:
    """In the place of a child process: the test has the other end."""

    far: Connection
    alive = True
    pid = 0

    def __init__(self, *_: object, **__: object) -> None:
        self.pipe, Played.far = Pipe()

    def kill(self) -> None:
        self.far.close()

    def end(self, _patience: float) -> None:
        self.far.close()

    def ended(self) -> str:
        return "by signal 9"


@pytest.fixture
def host(paper: RobotFile, write, monkeypatch: pytest.MonkeyPatch) -> Iterator[ControlHost]:
    """Of a process that ticks; its stages are nowhere to be found."""
    monkeypatch.setattr(control_host, "Child", Played)
    monkeypatch.setattr(control_host, "ANSWER_TIME", NET)
    ring = Ring(ring_width(paper))
    devices = load_station(write(OWN_DEVICES)).bench().devices
    assert isinstance(devices, BenchFile)
    host = ControlHost(replace(load_station(None).bench(), fifo=False), ring, lambda: devices, [].append, [].append)
    assert Played.far.recv() == devices
    ring.numbers[HEARTBEAT] = 1.0
    try:
        yield host
    finally:
        host.close()
        ring.close(remove=True)


def test_a_stop_waits_for_no_answer_of_a_process_that_has_just_ended(host: ControlHost) -> None:
    said: list[str] = []
    pressed = threading.Thread(target=lambda: said.append(host.stop()))
    pressed.start()
    assert Played.far.recv().cause == "stopped by the operator"
    Played.far.close()  # it dies with the command unanswered
    pressed.join()

    assert said[0].startswith("the stages on /dev/ttyUSB0 cannot be told to stop")
