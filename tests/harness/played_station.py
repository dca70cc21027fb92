"""A whole station in the test's process and in virtual time; a thread replaces the control process.

Service, supervisor, control host and control loop are those of a live station, and the same bytes go through the pipe.
Time passes only when the test advances it. A command is answered while the test waits, and the loop does not tick then.
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import pytest

from station.config.controllers import PERIOD_S
from station.control.clock import StationClock
from station.control.commands import Connect, SetStiffness
from station.control.driver_guard import DriverCalls
from station.control.process import _LiveLoop
from station.control.ring import STATION_HEARTBEAT, Ring
from station.control.states import RefusedError, State
from station.devices.config import BenchFile
from station.service import control_host
from station.service.commands import Home
from station.service.station_file import Rig, load_station
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


class WatchedPipe:
    """End of a pipe that passes each message on to `sent` after it was sent."""

    def __init__(self, near: Connection, sent: Callable[[Any], None]) -> None:
        self._near, self._sent = near, sent
        self.recv, self.close = near.recv, near.close

    def send(self, message: Any) -> None:
        self._near.send(message)
        self._sent(message)


class PlayedControl:
    """Replacement of the control process: a thread that reads the pipe as the control process does."""

    newest: "PlayedControl"
    looping: Callable[[Connection], _LiveLoop]  #: returns the loop of a new control process with this end of the pipe
    sent: list[Callable[[Any], None]]  #: functions that are called with each message to the control process
    alive = True
    pid = 0

    def __init__(self, *_: object, **__: object) -> None:
        near, self.far = Pipe()
        self.pipe = WatchedPipe(near, lambda message: [each(message) for each in self.sent])
        self.turn = threading.Lock()  # held by the thread while it answers, and by the test while it ticks
        self.live = type(self).looping(self.far)
        self.thread = threading.Thread(target=self._listen, name="played control")
        PlayedControl.newest = self
        self.thread.start()

    def _listen(self) -> None:
        assert isinstance(self.far.recv(), BenchFile)
        while self.far.poll(None):
            with self.turn:
                if not self.live._listen(self.live._clock.now() - self.live._started):
                    break
        self.alive = False
        self.far.close()

    def send(self, message: Any) -> None:
        self.pipe.send(message)

    def kill(self) -> None:
        assert not self.alive, "nothing here may have to be killed"

    def end(self, _patience: float) -> None:
        """End the control process, also unexpectedly for the station."""
        if self.alive:
            self.pipe.send(None)
        self.thread.join()

    def ended(self, _patience: float | None = None) -> str:
        return "with status 0"


class PlayedStation:
    """The station, with methods that advance its time."""

    def __init__(self, supervisor: Supervisor, virtual: VirtualStation, clock: HandClock) -> None:
        self.supervisor = supervisor
        self.virtual, self.clock = virtual, clock
        self._tick = 0

    @property
    def _live(self) -> _LiveLoop:
        return PlayedControl.newest.live

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

    def kill_control(self) -> None:
        """End the control process; wait until the station reports it. A reset starts another one."""
        control = self.supervisor._processes.control
        assert control is not None
        PlayedControl.newest.end(0.0)
        until(control._over.is_set)
        self.virtual.loop.stop(self.virtual.now)  # as the fallback stop does, which uses the ports of real stages
        for _ in range(100):
            self.clock.pass_(PERIOD_S)
            self._tick += 1
            self.virtual.lab.advance(self._tick * PERIOD_S)
            self.virtual.devices.stages.poll(self._tick * PERIOD_S)

    def reported(self) -> None:
        """Wait until the station has received every report of the past ticks."""
        with contextlib.suppress(RefusedError):
            # It is refused without a contact; its answer follows the earlier reports.
            self.supervisor.command_control(SetStiffness(stiffness=(1.0, 1.0, 1.0)))

    def becomes(self, state: State, most: float = 60.0) -> None:
        for _ in range(round(most / PERIOD_S)):
            if self.state is state:
                return
            self.tick()
        raise AssertionError(f"not {state.name} but {self.state.name}: {self.virtual.loop.cause}")

    def settle(self) -> None:
        """Return the station to READY, whatever its state is."""
        self.supervisor.stop()
        if self.state in (State.STOPPED, State.FAULT):
            self.supervisor.reset()
        self.tick(200)  # until the axes are at rest
        if self.state is State.OFF:  # a STOP was sent while a reset connected the devices again
            self.supervisor.send(Connect())
            self.tick()
        while self.state in (State.OFF, State.CONNECTING):
            self.tick()
        if self.state is State.CONNECTED:
            self.supervisor.send(Home(way_is_clear=True, then_working_pose=False))
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
        loops = iter([virtual.loop])

        def looping(far: Connection) -> _LiveLoop:
            loop = next(loops, None) or virtual.restart_loop()
            return _LiveLoop(loop, DriverCalls(ring, clock), bench.control, ring, far, os.getppid())

        patch.setattr(PlayedControl, "looping", staticmethod(looping), raising=False)
        patch.setattr(PlayedControl, "sent", [], raising=False)
        supervisor.lab.open()
        supervisor._processes._start_control()  # without the watchdog, which uses the computer's time
        station = PlayedStation(supervisor, virtual, clock)
        clock.ticks.append(station.tick)
        try:
            station.tick()
            until(lambda: supervisor._state.reported is not State.OFF)
            station.becomes(State.READY)
            yield station
        finally:
            supervisor.close()
