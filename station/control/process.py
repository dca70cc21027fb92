"""The control process: runs the control loop at 500 Hz in a separate process.

Commands arrive through a pipe that is polled without waiting; telemetry leaves through shared memory. When the station
process is gone, the axes are stopped and this process ends.
"""

import contextlib
import os
import select
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from core.compiled import PREPARED
from core.control.controller_settings import Controller
from core.errors import CtrError
from station.config.controllers import PERIOD_S
from station.config.plugins import preload
from station.config.robots import RobotFile
from station.control import follow
from station.control.child_process import StationLife
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.commands import CommandMessage, Reply, Stop
from station.control.driver_guard import DriverCalls, guard_drivers
from station.control.loop import ControlLoop
from station.control.messages import CommandRefused, DeviceReport, DeviceStatus, StateNotice
from station.control.monitors import Margins, OverrunLimits, Overruns
from station.control.realtime import Life, life, load, request_realtime, set_process_name, too_busy
from station.control.ring import (
    BALL_PORT,
    DRIVEN,
    DRIVER,
    GENERATION,
    HEARTBEAT,
    PHASE,
    PREPARED_LATE,
    PROGRESS,
    RUN,
    SCHEDULER,
    STATE,
    Ring,
)
from station.control.sleep import SleepDetector
from station.control.states import MOVING, State, Transition, check_state
from station.control.task import Phase, StreamRequest
from station.control.telemetry import Channels
from station.devices.config import BenchFile
from station.devices.guard import DriverError
from station.devices.interfaces import Devices, Severity
from station.devices.registry import emergency_stop, open_devices
from station.devices.stereo.tracker import StereoTracker

#: Time without heartbeat and without use of a processor after which the station process counts as stalled, so that
#: motion is stopped [s].
STATION_TIMEOUT_S = 1.0
#: Time without a heartbeat after which motion is stopped even if the station process uses processor time [s]. A station
#: process that is so busy could not execute a STOP either.
STATION_BUSY = 10.0
#: Time without a heartbeat after which this process checks whether the station process is being killed [s].
STATION_CHECK_AFTER_S = 0.045
#: Time at the end of this process for the last stop commands to be transmitted and answered [s].
FINAL_STOP_TIME_S = 0.25
#: Time after the end of the station process at which this process ends, too, even if an installed driver blocks [s].
ORPHAN_TIME = 10
#: Interval between two `DeviceReport` messages [ticks].
REPORT_TICKS = 250


@dataclass(frozen=True)
class ControlSetup:
    """Start parameters of the control process."""

    robot: RobotFile
    controller: Controller  #: controller of the loop until a run sets another one
    rehearse: Callable[[Controller], None]  #: function that compiles all code that a tick may execute
    margins: Margins = field(default_factory=Margins)
    overruns: OverrunLimits = field(default_factory=OverrunLimits)
    fifo: bool = True  #: whether to request real-time scheduling
    core: int | None = None  #: index of the processor that is reserved for this process; None: any
    clock: StationClock = REAL_TIME_CLOCK  #: clock of every process of this station


def run_control(setup: ControlSetup, ring_name: str, pipe: Connection, parent: int) -> None:
    """Run the control process, which first waits for the description of the devices in `pipe`."""
    set_process_name("ctr-control")
    ring = Ring(ring_width(setup.robot), ring_name)
    try:
        preload()
        setup.rehearse(setup.controller)
        bench, stopped = _apply_command(pipe)
        if bench is None:
            return
        calls = DriverCalls(ring, setup.clock)
        devices = guard_drivers(open_devices(bench, setup.robot), bench, calls, setup.robot)
        ring.counters[DRIVEN], ring.counters[DRIVER] = 1, os.getpid()
        if isinstance(devices.tracker, StereoTracker):
            ring.numbers[BALL_PORT] = devices.tracker.port
        try:
            loop = ControlLoop(setup.controller, devices, setup.margins, calls.watched)
            if bench.can_measure_target:
                follow.warm_up()
            granted = request_realtime(fifo=setup.fifo, core=setup.core)
            ring.counters[SCHEDULER] = granted.fifo
            pipe.send(CommandRefused(granted.refused))
            _LiveLoop(loop, calls, setup, ring, pipe, parent).run(stopped)
        finally:
            _close(devices)
            if not _is_gone(parent) or _final_stop(bench, setup):
                ring.counters[DRIVER] = 0
    except (EOFError, ConnectionError):
        return  # the station process is gone
    except CtrError as error:
        with contextlib.suppress(OSError):
            pipe.send(StateNotice(State.FAULT, str(error), 0))
    except Exception as error:
        with contextlib.suppress(OSError):
            pipe.send(StateNotice(State.FAULT, f"the control process failed ({type(error).__name__}: {error})", 0))
        raise
    finally:
        ring.close(remove=os.getppid() != parent)


def _apply_command(pipe: Connection) -> tuple[BenchFile | None, bool]:
    """Return the description of the bench from the pipe (None: end the process), and whether a STOP came first.

    Other commands are refused, because the process is still starting.
    """
    stopped = False
    while isinstance(message := pipe.recv(), CommandMessage):
        stop = isinstance(message.command, Stop)
        stopped = stopped or stop
        refused = f"'{message.command.name}' is not possible: the control process is starting"
        pipe.send(Reply(message.number, "" if stop else refused))
    return message, stopped


def ring_width(robot: RobotFile) -> int:
    """Return the number of channels in a row of telemetry."""
    return len(Channels(robot.robot()))


def _is_gone(station: int) -> bool:
    """Return whether the station process, the parent of this one, has ended or is being killed."""
    return os.getppid() != station or life(station) is Life.ENDED


def _final_stop(bench: BenchFile, setup: ControlSetup) -> bool:
    """Stop every axis, homing axes included, because the station process is gone; return whether they have stopped."""
    stop = emergency_stop(bench.stages, setup.robot)
    if stop is not None:
        # An installed driver may raise anything, and there is no process to report to.
        with contextlib.suppress(BaseException):
            stop(setup.clock)
            return True
    return stop is None


class _LiveLoop:
    """Runner of the control loop in real time: it paces the ticks and executes the commands of the station process."""

    def __init__(
        self, loop: ControlLoop, calls: DriverCalls, setup: ControlSetup, ring: Ring, pipe: Connection, parent: int
    ) -> None:
        self._loop, self._ring, self._pipe, self._parent = loop, ring, pipe, parent
        self._calls, self._clock = calls, setup.clock
        # `Connection.poll` creates and registers a selector at each call, which is a tenth of a tick's processor time.
        self._commands = select.poll()
        self._commands.register(pipe, select.POLLIN)
        self._station = StationLife(ring, setup.clock, parent)
        self._overruns = Overruns(setup.overruns, PERIOD_S)
        self._sleep = SleepDetector()
        self._started = 0.0
        self._prepared = len(PREPARED)
        self._noted = StateNotice(State.OFF, "", 0)
        self._unsent: list[StateNotice] = []  # notices that the next tick sends

    def run(self, stopped: bool) -> None:
        """Tick until the station process closes the pipe or is gone; stop at once if a STOP came early (`stopped`)."""
        self._started = self._clock.now()
        self._loop.connect(0.0)
        if stopped:
            self._loop.stop(0.0)
        try:
            self._ticks()
        finally:
            if _is_gone(self._parent) and hasattr(signal, "alarm"):
                signal.signal(signal.SIGALRM, signal.SIG_DFL)
                signal.alarm(ORPHAN_TIME)
            # Stop the axes at the end, whatever has ended the loop.
            self._wind_down()

    def _ticks(self) -> None:
        tick, clock = 0, self._clock
        while True:
            due = self._started + tick * PERIOD_S
            left = due - clock.now()
            if left > 0.0:
                clock.sleep(left)
            start = clock.now()
            # A tick that starts a period or more too late skips whole periods; the loop never catches up in a burst.
            skipped = int((start - due) / PERIOD_S)
            self._ring.time_late(start - due, skipped)
            tick += skipped
            self._judge_lateness(tick * PERIOD_S, skipped)
            if not self._listen(tick * PERIOD_S):
                return
            self._tick(tick)
            self._ring.time_work(clock.now() - start)
            tick += 1

    def _judge_lateness(self, now: float, skipped: int) -> None:
        """End a motion after too many overruns; overruns count only during a motion or homing."""
        slow = self._calls.longest()  # slow call in the previous tick, which may have made this tick late
        if self._loop.state not in MOVING:
            self._overruns.forget()
            return
        late = self._overruns.check(now, skipped, slow)
        if late is not None:
            event = Transition.FAULT if late.severity is Severity.FAULT else Transition.HOLD
            if event is Transition.FAULT or self._loop.state is State.RUNNING:
                self._loop.stop(now, event, late.text, late.details)

    def _tick(self, tick: int) -> None:
        loop, ring, now = self._loop, self._ring, tick * PERIOD_S
        if slept := self._sleep.check():
            loop.wake(now, slept)
        row = loop.tick(now, ring.truth(), self._setpoint_request())
        if row is not None:
            ring.write(row)
        self._report(now)
        self._note()
        while self._unsent:
            self._pipe.send(self._unsent.pop(0))
        standstill = self._station.standstill()  # at every tick: it compares the processor time with an earlier query
        if self._station.silence < STATION_TIMEOUT_S:
            if tick % REPORT_TICKS == 0:
                self._pipe.send(DeviceReport(_statuses(loop.devices, now, loop.warning)))
        elif loop.state in MOVING and (details := self._without_station(standstill)):
            silent = f"the station process was silent for {self._station.silence:.1f} s, and all axes were stopped"
            loop.stop(now, cause=too_busy(silent), details=details)

    def _without_station(self, standstill: float) -> str:
        """Return details of the station process's silence if motion must stop; empty if it may continue."""
        if standstill > STATION_TIMEOUT_S:
            return f"the station process used no processor for {standstill:.1f} s, or it is suspended; {load()}"
        if self._station.silence > STATION_BUSY:
            return f"the station process ran without a heartbeat, so it could not take a STOP; {load()}"
        return ""

    def _setpoint_request(self) -> StreamRequest | None:
        """Return the latest request for this run's streamed tip, in the loop's time."""
        request = self._ring.request(self._loop.run)
        if request is None or request.setpoint is None:
            return request
        setpoint = request.setpoint
        return StreamRequest(request.run, setpoint._replace(time=setpoint.time - self._started))

    def _report(self, now: float) -> None:
        loop, ring = self._loop, self._ring
        ring.counters[STATE], ring.counters[PHASE], ring.counters[RUN] = loop.state, loop.phase, loop.run
        ring.counters[PREPARED_LATE] = len(PREPARED) - self._prepared
        ring.numbers[PROGRESS], ring.numbers[HEARTBEAT] = loop.part_done(now), self._clock.now()

    def _note(self) -> None:
        """Note a change of the state; the next tick sends the notice to the station process."""
        loop = self._loop
        progress = loop.progress
        known = progress is not None and progress.phase in (Phase.SETTLING, Phase.MOVING)
        start = self._started + progress.motion_start if progress is not None and known else None
        notice = StateNotice(loop.state, loop.cause, loop.run, start, loop.cause_details, loop.contact)
        if notice != self._noted:
            self._noted = notice
            self._unsent.append(notice)

    def _listen(self, now: float) -> bool:
        """Execute the commands that have arrived; return False if the station process is gone."""
        if os.getppid() != self._parent:
            return False
        if STATION_CHECK_AFTER_S < self._station.silence < STATION_BUSY:
            station = life(self._parent)
            if station is Life.ENDED:
                return False
            if station is Life.SUSPENDED and self._loop.state in MOVING:
                self._loop.stop(now, cause="the station process was suspended, and all axes were stopped")
        try:
            while self._commands.poll(0):
                message: CommandMessage | None = self._pipe.recv()
                if message is None:
                    return False
                # Report a state before the next command ends it: a reset must not hide how a run has ended.
                self._note()
                refused = self._obey(message, now)
                # Publish the new state before the reply.
                self._report(now)
                self._pipe.send(Reply(message.number, refused))
        except (EOFError, OSError):
            return False
        return True

    def _obey(self, message: CommandMessage, now: float) -> str:
        """Execute one command; return why it was refused, or an empty text if it was accepted."""
        command = message.command
        if self._clock.now() > message.until:
            return f"'{command.name}' arrived after its deadline"  # the sender has already received a timeout
        if message.generation not in (None, int(self._ring.counters[GENERATION])):
            return f"'{command.name}' was requested before a STOP or a reset"
        try:
            check_state(self._loop.state, command.name, command.states)
            command.apply(self._loop, now)
        except CtrError as error:
            return str(error)
        return ""

    def _wind_down(self) -> None:
        """Stop every axis and wait until the serial lines have transmitted the stop commands."""
        started = self._clock.now()
        with contextlib.suppress(DriverError):  # the station process then stops the axes and reports the error
            self._loop.stop(started - self._started, cause="the station process is gone")
            while self._clock.now() - started < FINAL_STOP_TIME_S:
                self._clock.sleep(PERIOD_S)
                self._loop.devices.stages.poll(self._clock.now() - self._started)


def _statuses(devices: Devices, now: float, warning: str) -> tuple[DeviceStatus, ...]:
    found: list[DeviceStatus] = []
    for name, device in devices.by_kind.items():
        trouble = device.trouble(now)
        severity, text = (0, "") if trouble is None else (int(trouble.severity), str(trouble))
        if trouble is None and name == "tracker" and warning:
            severity, text = int(Severity.WARN), warning
        found.append(
            DeviceStatus(name=name, condition=device.condition, severity=severity, text=text, details=device.details())
        )
    return tuple(found)


def _close(devices: Devices) -> None:
    """Close every device, even if another one fails."""
    for device in devices.by_kind.values():
        with contextlib.suppress(CtrError, OSError):
            device.close()
