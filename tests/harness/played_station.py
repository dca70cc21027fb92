"""A whole station in the test's process and in virtual time; a thread replaces the control process.

Service, supervisor, control host and control loop are those of a live station, and the same bytes go through the pipe.
Time passes only when the test advances it. A command is answered while the test waits, and the loop does not tick then.
"""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from typing import Any

import pytest

from station.config.controllers import PERIOD_S
from station.control.clock import StationClock
from station.control.driver_guard import DriverCalls
from station.control.process import _LiveLoop
from station.control.ring import STATION_HEARTBEAT, Ring
from station.control.states import State
from station.devices.config import BenchFile
from station.service import control_host
from station.service.station_file import Rig, load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from tests.harness.virtual_station import VirtualStation
from tests.harness.waiting import NET, until

#: Devices of the station file, which are never opened: the thread uses the devices of a virtual bench instead.
DEVICES = BenchFile(
    stages={"driver": "zaber", "port": "/dev/ttyUSB0"},
    tracker={"driver": "aurora", "port": "/dev/ttyUSB1"},
    sensors={"driver": "netft", "tubes": {"inner": {"host": "192.168.1.11"}, "outer": {"host": "192.168.1.12"}}},
)


@dataclass(frozen=True)
class HandClock(StationClock):
    """Clock that the test advances by hand."""

    passed: list[float] = field(default_factory=lambda: [0.0])
    # functions to call while other code sleeps on this clock
    ticks: list[Callable[[], None]] = field(default_factory=list)

    def now(self) -> float:
        return self.passed[0]

    def pass_(self, seconds: float) -> None:
        self.passed[0] += seconds

    def real(self, seconds: float) -> float:
        return NET if seconds > 0.0 else 0.0

    def sleep(self, seconds: float) -> None:
        for tick in self.ticks:
            tick()


class PlayedControl:
    """Replacement of the control process: a thread that reads the pipe as the control process does."""

    newest: "PlayedControl"
    alive = True
    pid = 0

    def __init__(self, *_: object, **__: object) -> None:
        self.pipe, self.far = Pipe()
        self.turn = threading.Lock()  # held by the thread while it answers, and by the test while it ticks
        self.live: _LiveLoop | None = None
        self.thread = threading.Thread(target=self._listen, name="played control")
        PlayedControl.newest = self

    def _listen(self) -> None:
        assert isinstance(self.far.recv(), BenchFile)
        while self.far.poll(None):
            with self.turn:
                assert self.live is not None
                if not self.live._listen(self.live._clock.now() - self.live._started):
                    break
        self.alive = False
        self.far.close()

    def send(self, message: Any) -> None:
        self.pipe.send(message)

    def kill(self) -> None:
        raise AssertionError("nothing here may have to be killed")

    def end(self, _patience: float) -> None:
        self.pipe.send(None)
        self.thread.join()

    def ended(self, _patience: float | None = None) -> str:
        return "with status 0"


class PlayedStation:
    """The station, with methods that advance its time."""

    def __init__(self, supervisor: Supervisor, virtual: VirtualStation, clock: HandClock, live: _LiveLoop) -> None:
        self.supervisor, self.service = supervisor, StationService(supervisor)
        self.virtual, self.clock, self._live = virtual, clock, live
        self._tick = 0

    @property
    def state(self) -> State:
        return self.virtual.loop.state

    def tick(self, count: int = 1) -> None:
        ring, virtual = self.supervisor.ring, self.virtual
        for _ in range(count):
            with PlayedControl.newest.turn:
                self.clock.pass_(PERIOD_S)
                ring.numbers[STATION_HEARTBEAT] = self.clock.now()
                virtual.now = self._tick * PERIOD_S
                ring.publish_ground_truth(virtual.lab.advance(virtual.now))
                self._live._tick(self._tick)
                self._tick += 1

    def becomes(self, state: State, most: float = 60.0) -> None:
        for _ in range(round(most / PERIOD_S)):
            if self.state is state:
                return
            self.tick()
        raise AssertionError(f"not {state.name} but {self.state.name}: {self.virtual.loop.cause}")

    def settle(self) -> None:
        """Return the station to READY, whatever its state is."""
        self.supervisor.stop()
        if self.state is State.STOPPED:
            self.supervisor.reset()
        self.tick(200)  # until the axes are at rest
        if self.state is State.OFF:  # a STOP was sent while a reset connected the devices again
            self.supervisor.connect()
            self.tick()
        while self.state in (State.OFF, State.CONNECTING):
            self.tick()
        if self.state is State.CONNECTED:
            self.supervisor.home()
        self.becomes(State.READY)


@contextmanager
def played_station(virtual: VirtualStation) -> Iterator[PlayedStation]:
    """Yield a station that is READY, on the devices of a virtual bench that was not ticked before."""
    clock = HandClock()
    bench: Rig = replace(load_station(None).bench(), devices=DEVICES, fifo=False, clock=clock)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(control_host, "ChildProcess", PlayedControl)
        supervisor = Supervisor(bench)
        ring: Ring = supervisor.ring
        supervisor._processes.lab.open()
        supervisor._processes._start_control()  # without the watchdog, which uses the computer's time
        control = PlayedControl.newest
        live = _LiveLoop(virtual.loop, DriverCalls(ring, clock), bench.control, ring, control.far, os.getppid())
        control.live = live
        control.thread.start()
        station = PlayedStation(supervisor, virtual, clock, live)
        clock.ticks.append(station.tick)
        try:
            station.tick()
            until(lambda: supervisor._state.reported is not State.OFF)
            station.becomes(State.READY)
            yield station
        finally:
            supervisor.close()
