"""A running station: what may be asked of it, and what follows from what its processes say.

It is made of its processes, its runs and its state; it touches a device only when the control process has died, to
stop the stages.
"""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.control.jog import Space
from station.control.messages import DeviceReport, Notice, Refused
from station.control.process import ring_width
from station.control.realtime import leave
from station.control.ring import STATE, Ring
from station.control.states import Event, RefusedError, State, after
from station.control.telemetry import Channels
from station.lab.faults import LabFault
from station.lab.loads import Load
from station.service.audit import Audit
from station.service.bench import Bench
from station.service.control_host import Ending, Said, Unanswered
from station.service.flight_recorder import FlightRecorder
from station.service.last_stop import Stopped
from station.service.once_at_a_time import OnceAtATime
from station.service.processes import CONTROL, Processes
from station.service.runs import Runs
from station.service.start import Run, Start
from station.service.status import StateMonitor, Status

#: A control process that is started anew has so long to load what it needs and to begin [s].
RESTART_TIME = 120.0


class Supervisor:
    """One station. OFF, without a process, until it is opened; any thread may ask."""

    def __init__(self, bench: Bench, folder: Path | None = None, audit: Audit | None = None) -> None:
        """Every run is recorded in `folder`, every change of state in `audit`, if given."""
        self.bench, self._clock = bench, bench.clock
        self.robot = bench.robot.robot()
        self.channels = Channels(self.robot)
        self.statics = Statics(self.robot)
        self.ring = Ring(ring_width(bench.robot))
        self._runs = Runs(bench, self.ring, folder)
        self._state = StateMonitor(self.ring, self.channels, bench.clock)
        self._flight_recorder = FlightRecorder(self.ring, self.channels, audit, folder, self._runs.session)
        self._processes = Processes(bench, self.ring, self._hear, self._ended, self._runs.problem)
        self._reset_once = OnceAtATime(self._reset)
        self._reserved = ""  # why nobody but a procedure may move anything

    def open(self) -> None:
        """Start every process; once."""
        self._runs.open()
        for folder in self._runs.recovered:
            self._flight_recorder.note("recovered", f"run {folder.name}, which was left unfinished")
        for sentence in self._runs.left_alone:
            self._flight_recorder.note("not recovered", sentence)
        self._processes.open()

    def wait_ready(self, timeout: float, since: int = 0) -> None:
        """Wait until telemetry has gone beyond row `since`, or until stages wait for a person to home them.

        Raises:
            CtrError: it does not, in `timeout` [s].
        """
        deadline = self._clock.now() + timeout
        while self._state.said is not State.CONNECTED and (
            self.ring.written <= since or int(self.ring.counters[STATE]) == State.HOMED
        ):
            if self._state.said is State.FAULT:
                raise CtrError(f"the station did not come up: {self._state.cause}")
            if self._processes.closing:
                raise RefusedError("the station is ending")
            if self._state.said is State.OFF and self._state.cause:
                raise CtrError(f"the station did not come up: {self._state.cause}; connect to go on")
            if self._clock.now() > deadline:
                raise CtrError(f"the station did not come up within {timeout:g} s: {self._state.troubles()}")
            self._clock.sleep(0.02)
        leave(self.bench.core, (pid for name, pid in self.pids().items() if name != "control"))

    def status(self) -> Status:
        """The present state, timing and newest telemetry."""
        return self._state.look(self._runs.current, self._runs.recording, self._reserved, self.bench.warnings)

    def pids(self) -> dict[str, int]:
        """Number of every process that lives."""
        found = self._processes.pids()
        return found if self._runs.pid is None else {**found, "recorder": self._runs.pid}

    @property
    def recovered(self) -> list[Path]:
        """Folders of runs that a station before this one has left unfinished; they are finished now."""
        return self._runs.recovered

    def entered(self, state: State) -> int:
        """How often that state has been entered."""
        return self._state.entered(state)

    # What may be asked

    def start(self, start: Start) -> Run:
        """Have it carried out.

        Raises:
            RefusedError: the state does not allow it, or a procedure is on.
            ConfigError: faults are asked of devices that are real.
            RecordingError: it cannot be recorded.
        """
        self._check_free()
        return self._carry_out(start)

    def start_step(self, start: Start) -> Run:
        """Have a step of the procedure carried out that has the station to itself.

        Raises:
            RefusedError, ConfigError, RecordingError: as in `start`.
        """
        return self._carry_out(start)

    def reserve(self, why: str) -> None:
        """From now on only `start_step` moves anything, until `release`; STOP and reset are as always.

        Args:
            why: is told whoever is refused.

        Raises:
            RefusedError: not READY, or reserved already.
        """
        self._check_free()
        after(self._state.state, Event.START)
        self._reserved = why

    def release(self) -> None:
        """Everybody may move the robot again."""
        self._reserved = ""

    def stop(self, cause: str = "stopped by the operator") -> str:
        """Stop every axis; always accepted. What a person should know about it; empty when it is done."""
        return self._processes.stop(cause)

    def reset(self) -> str:
        """A person has seen the fault, stop or hold; processes that have died or stand still are started anew.

        Two at the same time are one.

        Returns:
            What has been started anew, in words; empty when it was nothing.

        Raises:
            RefusedError: there is nothing to reset.
            CtrError: they do not come back.
        """
        return self._reset_once()

    def _reset(self) -> str:
        anew = ("the recorder",) if self._runs.renew() else ()
        gone = self._processes.gone()
        if not gone:
            try:
                self._processes.ask(Event.RESET)
            except Unanswered:
                gone = self._processes.gone() or (CONTROL,)
            except RefusedError:
                if not anew:
                    raise
        if gone:
            self._processes.end_dead(gone)
            self.ring.clear_timing()
            since = self.ring.written
            self._state.forget()
            self._runs.forget()
            self._processes.start_anew()
            self.wait_ready(RESTART_TIME, since)
        told = " and ".join((*anew, *gone))
        if told:
            self._flight_recorder.note("reset", f"started anew: {told}")
        return told and f"started anew: {told}"

    def connect(self) -> None:
        """Find the devices, after they were given up.

        Raises:
            RefusedError: not OFF, or a procedure is on.
        """
        self._ask_freely(Event.CONNECT)

    def home(self, then: Start | None = None) -> None:
        """Home every stage, and `then` carry that out; a person has said that the way is clear.

        Raises:
            RefusedError: neither CONNECTED nor READY, a procedure is on, or the stages cannot.
        """
        if then is None:
            self._ask_freely(Event.HOME)
            return
        self._check_free()
        after(self._state.state, Event.HOME)
        self._ask_for(Event.HOME, then)

    def tare(self) -> None:
        """Make what the force sensors feel zero.

        Raises:
            RefusedError: not READY, or a procedure is on.
        """
        self._ask_freely("tare")

    def jog(self, space: Space, velocity: Array) -> None:
        """Move by hand for the next 0.3 s: (n,) [rad/s or m/s] joints, (3,) [m/s] tip, or (3,) [rad/s] its direction.

        Raises:
            RefusedError: not READY, a procedure is on, or the tip's direction is not controlled.
        """
        self._ask_freely("jog", space=space, velocity=velocity)

    def operator_gone(self) -> None:
        """Nobody commands any more; as configured, a run that is on goes on or is held."""
        if self.bench.on_operator_loss == "hold" and self._state.state is State.RUNNING:
            cause = "the operator has gone; this station holds a run then (on_operator_loss = 'hold')"
            with contextlib.suppress(RefusedError):  # it has just ended
                self._processes.ask(Event.HOLD, cause=cause)

    def apply_load(self, load: Load) -> None:
        """Put a load on the virtual lab's tip, now; the next motion brings its own."""
        self._processes.lab.apply_load(load)

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Let these faults of the virtual lab's devices happen from now on; none: clear all."""
        self._processes.lab.inject(faults)

    def end_control(self) -> Stopped:
        """End the control process, its axes stopped first; from now on nothing moves any more.

        Returns:
            What has been seen of the stages' stop.
        """
        return self._processes.end_control()

    def close(self) -> None:
        """End the control process, its axes stopped, then the lab, and remove the shared memory."""
        self._processes.close()
        self._runs.close()
        self._flight_recorder.close()
        self.ring.close(remove=True)

    def _check_free(self) -> None:
        if self._reserved:
            raise RefusedError(self._reserved)

    def _ask_freely(self, what: Event | Literal["tare", "jog"], **about: Any) -> None:
        self._check_free()
        self._processes.ask(what, **about)

    def _carry_out(self, start: Start) -> Run:
        self._processes.lab.check(start.faults)
        after(self._state.state, Event.START)
        return self._ask_for(Event.START, start)

    def _ask_for(self, what: Event, start: Start) -> Run:
        """Number a start and ask for it; after homing, or now."""
        run = self._runs.prepare(start)
        try:
            self._processes.ask(what, task=start.task, run=run.number)
        except RefusedError:
            self._runs.refused(run)
            raise
        self._runs.accepted(run)
        return run

    # What its processes say

    def _hear(self, message: Said) -> None:
        match message:
            case DeviceReport():
                self._state.hear_devices(message.devices)
            case Refused():
                self._state.hear_refused(message.warnings)
                for text in message.warnings:
                    self._flight_recorder.note("warning", text)
            case Notice():
                self._take(message)

    def _take(self, notice: Notice) -> None:
        if self._state.hear(notice.state, notice.cause):
            self._flight_recorder.state(notice.state, notice.cause)
            self._runs.state_changed(notice)
        self._runs.heard(notice)
        self._processes.lab.motion(self._runs.find(notice.run), notice.motion_start)

    def _ended(self, ending: Ending) -> None:
        """The control process has ended unasked, and the stages have been stopped."""
        cause = self._state.fault(ending.how, ending.stopped)
        self._flight_recorder.state(State.FAULT, cause)
        self._runs.interrupted(cause)
        self._processes.lab.motion(None, None)
