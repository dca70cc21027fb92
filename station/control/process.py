"""The control process: the control loop paced at 500 Hz in a process of its own.

Commands come in through a pipe that is looked at, never waited for; telemetry goes out through
shared memory. When the station process is gone the axes are stopped and this process ends.
"""

import contextlib
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from core.control.step import Controller
from core.errors import CtrError
from station.config.controllers import PERIOD
from station.config.robots import RobotFile
from station.control import follow
from station.control.clock import REAL_TIME, StationClock
from station.control.installed import Calls, DriverError, named
from station.control.led import Asked
from station.control.loop import ControlLoop
from station.control.margins import Margins
from station.control.messages import Command, DeviceName, DeviceReport, DeviceStatus, Notice, Refused, Reply
from station.control.overruns import OverrunLimits, Overruns
from station.control.realtime import be_punctual, is_dying, show_as
from station.control.ring import HEARTBEAT, PHASE, PROGRESS, RUN, SCHEDULER, STATE, STATION_HEARTBEAT, Ring
from station.control.states import Event, State
from station.control.task import Phase
from station.control.telemetry import Channels
from station.devices.config import BenchFile
from station.devices.interfaces import Devices, Severity
from station.devices.open_devices import open_devices
from station.devices.registry import emergency_stop

#: A station process that says nothing for so long counts as gone while something moves [s].
STATION_SILENT = 1.0
#: One that has said nothing for so long is looked at: is it being killed [s]?
STATION_DOUBTED = 0.045
#: The last stops get this long to be carried and answered [s].
LAST_WORDS = 0.25
#: Between two reports of the devices [ticks].
REPORT_TICKS = 250


@dataclass(frozen=True)
class ControlSetup:
    """What the control process is told when it starts."""

    robot: RobotFile
    controller: Controller  #: of the loop until a run brings its own
    rehearse: Callable[[Controller], None]  #: compiles everything that a tick can reach
    margins: Margins = field(default_factory=Margins)
    overruns: OverrunLimits = field(default_factory=OverrunLimits)
    fifo: bool = True  #: ask for real-time scheduling
    core: int | None = None  #: processor of its own; None: any
    clock: StationClock = REAL_TIME  #: of every process of this station


def run_control(setup: ControlSetup, ring_name: str, pipe: Connection, parent: int) -> None:
    """Main function of the control process; the first message through `pipe` says where the devices are."""
    # Ctrl-C in a terminal reaches the whole group: the station process decides when we end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    show_as("ctr-control")
    ring = Ring(ring_width(setup.robot), ring_name)
    try:
        setup.rehearse(setup.controller)
        told, stopped = _told(pipe)
        if told is None:
            return
        calls = Calls(ring, setup.clock)
        devices = named(open_devices(told, setup.robot), told, calls)
        try:
            loop = ControlLoop(setup.controller, devices, setup.margins)
            if told.may_tell_target:
                follow.load()
            granted = be_punctual(fifo=setup.fifo, core=setup.core)
            ring.counters[SCHEDULER] = granted.fifo
            pipe.send(Refused(granted.refused))
            _LiveLoop(loop, calls, setup, ring, pipe, parent).run(stopped)
        finally:
            _close(devices)
            if os.getppid() != parent or is_dying(parent):
                _stop_at_last(told, setup)
    except (EOFError, ConnectionError):
        return  # nobody is there any more
    except CtrError as error:
        with contextlib.suppress(OSError):
            pipe.send(Notice(State.FAULT, str(error), 0))
    except Exception as error:
        with contextlib.suppress(OSError):
            pipe.send(Notice(State.FAULT, f"the control process failed ({type(error).__name__}: {error})", 0))
        raise
    finally:
        ring.close(remove=os.getppid() != parent)


def _told(pipe: Connection) -> tuple[BenchFile | None, bool]:
    """Where the devices are (None to end), and whether somebody has said STOP before that; all else is too early."""
    stopped = False
    while isinstance(message := pipe.recv(), Command):
        stop = message.what is Event.STOP
        stopped = stopped or stop
        refused = f"'{message.what}' is not possible: the control process is starting"
        pipe.send(Reply(message.number, "" if stop else refused))
    return message, stopped


def ring_width(robot: RobotFile) -> int:
    """Numbers in a row of telemetry."""
    return len(Channels(robot.robot()))


def _stop_at_last(told: BenchFile, setup: ControlSetup) -> None:
    """The station process would make sure that every axis stops, those that home too; it is gone."""
    stop = emergency_stop(told.stages, setup.robot)
    if stop is not None:
        with contextlib.suppress(CtrError):  # there is nobody to tell it to
            stop(setup.clock)


class _LiveLoop:
    """The control loop with its clock and its commands."""

    def __init__(
        self, loop: ControlLoop, calls: Calls, setup: ControlSetup, ring: Ring, pipe: Connection, parent: int
    ) -> None:
        self._loop, self._ring, self._pipe, self._parent = loop, ring, pipe, parent
        self._calls, self._clock = calls, setup.clock
        self._overruns = Overruns(setup.overruns, PERIOD)
        self._begun = 0.0
        self._run = 0
        self._told = Notice(State.OFF, "", 0)

    def run(self, stopped: bool) -> None:
        """Tick until the station process closes the pipe or is gone; it begins OFF if it has been `stopped` already."""
        self._begun = self._clock.now()
        self._loop.connect(0.0)
        if stopped:
            self._loop.stop(0.0)
        try:
            self._ticks()
        finally:
            # Whatever ends it, the axes are stopped.
            self._wind_down()

    def _ticks(self) -> None:
        tick, clock = 0, self._clock
        while True:
            due = self._begun + tick * PERIOD
            left = due - clock.now()
            if left > 0.0:
                clock.sleep(left)
            start = clock.now()
            # Too late by a period or more: skip whole periods, never catch up in a burst.
            skipped = int((start - due) / PERIOD)
            self._ring.time_late(start - due, skipped)
            tick += skipped
            self._judge_lateness(tick * PERIOD, skipped)
            if not self._listen(tick * PERIOD):
                return
            self._tick(tick)
            self._ring.time_work(clock.now() - start)
            tick += 1

    def _judge_lateness(self, now: float, skipped: int) -> None:
        """Too much lateness ends a motion; what was late before it does not count."""
        if self._loop.state not in (State.RUNNING, State.HOMING):
            self._overruns.forget()
            return
        late = self._overruns.look(now, skipped)
        if late is not None:
            event = Event.FAULT if late.severity is Severity.FAULT else Event.HOLD
            if event is Event.FAULT or self._loop.state is State.RUNNING:
                self._loop.stop(now, event, "; ".join(text for text in (late.text, self._calls.longest()) if text))

    def _tick(self, tick: int) -> None:
        loop, ring, now = self._loop, self._ring, tick * PERIOD
        row = loop.tick(now, ring.truth(), self._asked())
        if row is not None:
            ring.write(row)
        self._report(now)
        self._notice()
        silent = self._clock.now() - float(ring.numbers[STATION_HEARTBEAT])
        if silent < STATION_SILENT:
            if tick % REPORT_TICKS == 0:
                self._pipe.send(DeviceReport(_statuses(loop.devices, now)))
        elif loop.state in (State.RUNNING, State.HOMING):
            loop.stop(now, cause=f"the station process has said nothing for {silent:.1f} s")

    def _asked(self) -> Asked | None:
        """What was asked of this run's tip last, in the loop's time."""
        asked = self._ring.asked(self._run)
        if asked is None or asked.wish is None:
            return asked
        return Asked(asked.run, asked.wish._replace(asked=asked.wish.asked - self._begun))

    def _report(self, now: float) -> None:
        loop, ring = self._loop, self._ring
        ring.counters[STATE], ring.counters[PHASE], ring.counters[RUN] = loop.state, loop.phase, self._run
        ring.numbers[PROGRESS], ring.numbers[HEARTBEAT] = loop.part_done(now), self._clock.now()

    def _notice(self) -> None:
        """Tell what has changed."""
        loop = self._loop
        progress = loop.progress
        known = progress is not None and progress.phase in (Phase.SETTLING, Phase.MOVING)
        start = self._begun + progress.motion_start if progress is not None and known else None
        notice = Notice(loop.state, loop.cause, self._run, start)
        if notice != self._told:
            self._told = notice
            self._pipe.send(notice)

    def _listen(self, now: float) -> bool:
        """Carry out what has arrived; False when nobody is there any more."""
        if os.getppid() != self._parent:
            return False
        silent = self._clock.now() - float(self._ring.numbers[STATION_HEARTBEAT])
        if STATION_DOUBTED < silent < STATION_SILENT and is_dying(self._parent):
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
        """Carry out one command; why not, if so."""
        loop = self._loop
        if self._clock.now() > command.until:
            return f"'{command.what}' came too late to be carried out"  # whoever asked has been told so
        try:
            match command.what:
                case Event.STOP:
                    loop.stop(now, cause=command.cause)
                case Event.HOLD:
                    loop.stop(now, Event.HOLD, command.cause)
                case Event.START if command.task is not None:
                    loop.start(command.task)
                    self._run = command.run
                case Event.RESET:
                    loop.reset(now)
                case Event.CONNECT:
                    loop.connect(now)
                case Event.HOME:
                    loop.home(now, command.task)
                    self._run = command.run
                case "tare":
                    loop.tare(now)
                case "jog" if command.velocity is not None:
                    loop.jog(now, command.space, command.velocity)
                case _:
                    return f"'{command.what}' is nothing that can be asked for"
        except CtrError as error:
            return str(error)
        return ""

    def _wind_down(self) -> None:
        """Stop every axis and give the lines the time to carry the stops."""
        begin = self._clock.now()
        with contextlib.suppress(DriverError):  # somebody else stops them then, and tells
            self._loop.stop(begin - self._begun, cause="the station process is gone")
            while self._clock.now() - begin < LAST_WORDS:
                self._clock.sleep(PERIOD)
                self._loop.devices.stages.poll(self._clock.now() - self._begun)


def _statuses(devices: Devices, now: float) -> tuple[DeviceStatus, ...]:
    found: list[DeviceStatus] = []
    names: tuple[DeviceName, ...] = ("stages", "tracker", "sensors")
    for name, device in zip(names, (devices.stages, devices.tracker, devices.sensors), strict=True):
        trouble = device.trouble(now)
        severity, text = (0, "") if trouble is None else (int(trouble.severity), trouble.text)
        found.append(
            DeviceStatus(name=name, condition=device.condition, severity=severity, text=text, details=device.details())
        )
    return tuple(found)


def _close(devices: Devices) -> None:
    """Every one, even if another fails."""
    for device in (devices.stages, devices.tracker, devices.sensors):
        with contextlib.suppress(CtrError, OSError):
            device.close()
