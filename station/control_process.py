"""The control process: the control loop paced at 500 Hz in a process of its own.

Commands come in through a pipe that is looked at, never waited for; telemetry goes out through
shared memory. When the station process is gone the axes are stopped and this process ends.
"""

import os
import signal
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from core.errors import CtrError
from core.robot import Array
from core.step import Sample, begin, step
from core.trajectories import Setpoint
from station.experiments.experiment import PERIOD, ControllerFile
from station.lab.config import LabConfig
from station.lab.loads import Load, NoLoad
from station.lab.virtual_lab import VirtualLab
from station.loop import ControlLoop, Phase, Task
from station.motions import HoldMotion, Orders
from station.realtime import ask_for_fifo, calm_memory
from station.ring import HEARTBEAT, PHASE, PROGRESS, RUN, SCHEDULER, STATE, Ring
from station.robots import RobotFile
from station.states import Event, RefusedError, State
from station.telemetry import Channels


@dataclass(frozen=True)
class Bench:
    """What the control process is in charge of."""

    robot: RobotFile
    lab: LabConfig
    seed: int
    park: tuple[float, ...]  #: joints at power-up [rad or m]
    controller: ControllerFile
    fifo: bool = True  #: ask for real-time scheduling


class Command(NamedTuple):
    """Station process -> control process."""

    number: int  #: echoed in the reply
    event: Event
    task: Task | None = None
    load: Load = NoLoad()
    run: int = 0


class Reply(NamedTuple):
    """Control process -> station process: the answer to a command."""

    number: int
    refused: str  #: empty when it was carried out


class Notice(NamedTuple):
    """Control process -> station process: the state has changed."""

    state: State
    cause: str
    run: int  #: the run it is about


def run_control(bench: Bench, ring_name: str, pipe: Connection, parent: int) -> None:
    """Main function of the control process."""
    # Ctrl-C in a terminal reaches the whole group: the station process decides when we end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ring = Ring(ring_width(bench.robot), ring_name)
    try:
        _warm_up(bench)
        loop = _LiveLoop(bench, ring, pipe, parent)
        ring.counters[SCHEDULER] = bench.fifo and ask_for_fifo()
        calm_memory()
        loop.run()
    finally:
        ring.close(remove=os.getppid() != parent)


def ring_width(robot: RobotFile) -> int:
    """Numbers in a row of telemetry."""
    return len(Channels(robot.robot()))


def compile_plant(bench: Bench) -> None:
    """Compile the plant into the cache on disk, where the control process will look for it."""
    VirtualLab(bench.robot, bench.lab, bench.seed, np.array(bench.park))


class _LiveLoop:
    """The control loop with its clock, its commands and its virtual lab."""

    def __init__(self, bench: Bench, ring: Ring, pipe: Connection, parent: int) -> None:
        park = np.array(bench.park)
        self._lab = VirtualLab(bench.robot, bench.lab, bench.seed, park)
        self._loop = ControlLoop(bench.controller.controller(bench.robot), self._lab.devices)
        self._ring, self._pipe, self._parent = ring, pipe, parent
        self._load: Load = NoLoad()
        self._run = 0
        self._told = (State.OFF, "")
        self._row: Array | None = None

    def run(self) -> None:
        """Tick until the station process closes the pipe or is gone."""
        begin = time.perf_counter()
        tick = 0
        while True:
            due = begin + tick * PERIOD
            left = due - time.perf_counter()
            if left > 0.0:
                time.sleep(left)
            start = time.perf_counter()
            # Too late by a period or more: skip whole periods, never catch up in a burst.
            skipped = int((start - due) / PERIOD)
            self._ring.time_late(start - due, skipped)
            tick += skipped
            if not self._listen(tick * PERIOD):
                break
            self._tick(tick * PERIOD)
            self._ring.time_work(time.perf_counter() - start)
            tick += 1
        self._wind_down(tick)

    def _tick(self, now: float) -> None:
        loop, ring = self._loop, self._ring
        truth = self._lab.advance(now)
        phase = loop.phase
        row = loop.tick(now, truth)
        if row is not None:
            self._row = row
            if loop.state is State.OFF:
                # The virtual lab comes up by itself; a bench with motors waits for a person.
                for event in (Event.CONNECT, Event.HOME, Event.PREPARE):
                    loop.request(event)
        elif self._row is not None:
            # No fresh estimate: time and state go on, the rest stands.
            self._row[0], self._row[1] = now, loop.state
        if self._row is not None:
            ring.write(self._row)
        if loop.phase is not phase:
            self._follow_phase()
        self._report(now)
        if (loop.state, loop.cause) != self._told:
            self._told = (loop.state, loop.cause)
            self._pipe.send(Notice(loop.state, loop.cause, self._run))

    def _report(self, now: float) -> None:
        loop, ring = self._loop, self._ring
        ring.counters[STATE], ring.counters[PHASE], ring.counters[RUN] = loop.state, loop.phase, self._run
        ring.numbers[PROGRESS], ring.numbers[HEARTBEAT] = loop.part_done(now), time.monotonic()

    def _follow_phase(self) -> None:
        """The load is on during the motion only."""
        progress = self._loop.progress
        if progress is None:
            self._lab.pull(NoLoad(), 0.0)
        elif progress.phase is Phase.SETTLING:
            self._lab.pull(self._load, progress.motion_start)

    def _listen(self, now: float) -> bool:
        """Carry out what has arrived; False when nobody is there any more."""
        if os.getppid() != self._parent:
            return False
        try:
            while self._pipe.poll():
                command: Command | None = self._pipe.recv()
                if command is None:
                    return False
                refused = self._obey(command, now)
                # The new state is there to see before the answer is.
                self._report(now)
                self._pipe.send(Reply(command.number, refused))
        except (EOFError, OSError):
            return False
        return True

    def _obey(self, command: Command, now: float) -> str:
        try:
            if command.event is Event.STOP:
                self._loop.stop(now)
            elif command.event is Event.START and command.task is not None:
                self._loop.start(command.task)
                self._load, self._run = command.load, command.run
            else:
                self._loop.request(command.event)
                if command.event is Event.RESET and self._loop.state is State.CONNECTED:
                    for event in (Event.HOME, Event.PREPARE):
                        self._loop.request(event)
        except RefusedError as error:
            return str(error)
        return ""

    def _wind_down(self, tick: int) -> None:
        """Stop every axis and give the line the time to carry the stops."""
        now = tick * PERIOD
        self._loop.stop(now, cause="the station process is gone")
        while (tick := tick + 1) * PERIOD < now + 0.05:
            self._lab.advance(tick * PERIOD)
            self._loop.tick(tick * PERIOD)


def _warm_up(bench: Bench) -> None:
    """Compile everything a tick can reach, on a bench that is thrown away.

    The controller first: the plant is compiled by the station process meanwhile, see `compile_plant`.
    """
    controller = bench.controller.controller(bench.robot)
    park, tubes = np.array(bench.park), len(bench.robot.tubes)
    still = Sample(park, np.zeros_like(park), np.zeros((tubes, 6)), np.zeros(3), 0.0)
    step(controller, begin(controller, still), still, Setpoint(np.zeros(3), np.zeros(3)))
    lab = VirtualLab(bench.robot, bench.lab, bench.seed, park)
    loop = ControlLoop(controller, lab.devices)
    task = Task(controller, Orders(HoldMotion(), bench.robot.robot()), 0.1)
    for tick in range(1500):
        row = loop.tick(tick * PERIOD, lab.advance(tick * PERIOD))
        if loop.state is State.OFF and row is not None:
            for event in (Event.CONNECT, Event.HOME, Event.PREPARE):
                loop.request(event)
            loop.start(task)
        elif loop.state is State.READY:
            return
    raise CtrError(f"the control loop did not get through its warm-up: {loop.cause or loop.phase.name}")
