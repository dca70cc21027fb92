"""Reaction of the station process to the end of the control process; here a pipe replaces that process."""

import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection

import pytest

from station.config.robots import RobotFile
from station.control.process import ring_width
from station.control.ring import DRIVEN, HEARTBEAT, Ring
from station.devices.config import BenchFile
from station.service import control_host
from station.service.control_host import ControlHost, ExitReport
from station.service.fallback_stop import NO_STAGES, StopOutcome
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES
from tests.harness.waiting import NET, until


class Played:
    """Replacement of a child process; the test owns the other end of its pipe."""

    far: Connection
    alive = True
    pid = 0

    def __init__(self, *_: object, **__: object) -> None:
        self.pipe, Played.far = Pipe()

    def kill(self) -> None:
        with suppress(OSError):  # the test may close the pipe at the same time
            self.far.close()

    def end(self, _patience: float) -> None:
        self.far.close()

    def ended(self, _patience: float) -> str:
        return "by signal 9"


@pytest.fixture
def reports() -> list[object]:
    """Return the list that receives the reports of the control host, in their order."""
    return []


@pytest.fixture
def host(paper: RobotFile, write, monkeypatch: pytest.MonkeyPatch, reports: list[object]) -> Iterator[ControlHost]:
    """Return the host of a control process whose loop ticks and whose stages do not exist."""
    monkeypatch.setattr(control_host, "ChildProcess", Played)
    monkeypatch.setattr(control_host, "REPLY_TIMEOUT_S", NET)
    monkeypatch.setattr(control_host, "STOP_REPLY_TIMEOUT_S", NET)
    ring = Ring(ring_width(paper))
    devices = load_station(write(OWN_DEVICES)).bench().devices
    assert isinstance(devices, BenchFile)
    host = ControlHost(
        replace(load_station(None).bench(), fifo=False), ring, lambda: devices, reports.append, reports.append
    )
    assert Played.far.recv() == devices
    ring.numbers[HEARTBEAT], ring.counters[DRIVEN] = 1.0, 1
    try:
        yield host
    finally:
        host.close()
        ring.close(remove=True)


def test_stop_does_not_wait_for_an_answer_of_an_ended_control_process(host: ControlHost) -> None:
    outcomes: list[StopOutcome] = []
    pressed = threading.Thread(target=lambda: outcomes.append(host.stop()))
    pressed.start()
    assert Played.far.recv().command.cause == "stopped by the operator"
    Played.far.close()  # the process ends without an answer to the command
    pressed.join()

    assert not outcomes[0].confirmed
    assert outcomes[0].text.startswith("the stages on /dev/ttyUSB0 cannot be commanded to stop")


def test_exit_report_does_not_mention_stages_that_the_station_has_never_driven(
    host: ControlHost, paper: RobotFile, reports: list[object]
) -> None:
    """The station must not access stages that it has never driven: another station may use their port."""
    host._ring.counters[DRIVEN] = 0
    Played.far.close()
    assert until(lambda: reports) == [ExitReport("the control process ended by signal 9", "")]
    assert host.stop() == StopOutcome(True, "there is no control process and nothing moves")
    assert host.close() == NO_STAGES


def test_fault_is_reported_before_the_outcome_of_stopping_the_stages(host: ControlHost, reports: list[object]) -> None:
    Played.far.close()
    fault, stopped = until(lambda: len(reports) > 1 and reports)
    assert fault == ExitReport("the control process ended by signal 9", "the stages are being stopped")
    assert isinstance(stopped, StopOutcome)
    assert not stopped.confirmed
