"""The station process's side of control: starts the lab and the control process, asks them, watches them.

Everything a browser or a script may want goes through `Supervisor`; it touches a device only when the
control process has died, to stop the stages.
"""

import contextlib
import itertools
import os
import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.control.messages import DeviceReport, DeviceStatus, Refused
from station.control.process import ring_width
from station.control.realtime import ask_for_fifo, one_thread_each
from station.control.ring import HEARTBEAT, PHASE, PROGRESS, RUN, STATE, STATION_HEARTBEAT, STUCK, Ring
from station.control.states import Event, RefusedError, State, after
from station.control.task import Phase, Task
from station.control.telemetry import Channels
from station.lab.faults import LabFault
from station.lab.loads import Load
from station.recording.tracking_errors import settling_time
from station.service.audit import Audit
from station.service.backend import Backend, RunEffects
from station.service.bench import Bench
from station.service.control_host import WATCHER_PRIORITY, ControlHost, Ending, Said
from station.service.flight_recorder import FlightRecorder
from station.service.live_recording import LiveRecording
from station.service.status import Status

#: A control process that has begun to tick and has not for so long is hung: it is ended, the stages are stopped [s].
HUNG = 1.0
#: The same until the station has been READY once [s].
FIRST_TICKS = 60.0
#: Between two looks of the watchdog [s].
LOOK = 0.02
STUCK_TEXT = "the simulated robot cannot follow its stages under its load and stays where it is: take the load off"


class Supervisor:
    """Owner of the control process and of the virtual lab's. OFF, without a process, until it is opened."""

    def __init__(self, bench: Bench, runs: Path | None = None, audit: Audit | None = None) -> None:
        """Every run is recorded in the folder `runs`, every change of state in `audit`, if given."""
        self.bench, self._clock = bench, bench.clock
        self.robot = bench.robot.robot()
        self.channels = Channels(self.robot)
        self.statics = Statics(self.robot)
        self.ring = Ring(ring_width(bench.robot))
        self.task: Task | None = None  #: what the run that is on, or the last one, has to do
        self._session = f"{datetime.now().astimezone():%Y%m%d-%H%M%S}"
        self._runs = itertools.count(1)
        self._lock = threading.Lock()
        self._cause = ""
        self._state = State.OFF
        self._run, self._title = 0, ""
        self._reserved = ""  # why nobody but a procedure may move anything
        self._devices: tuple[DeviceStatus, ...] = ()
        self._closing = threading.Event()
        self._folder = runs
        self.recording: LiveRecording | None = None
        self._flight_recorder = FlightRecorder(self.ring, self.channels, audit, runs, self._session)
        self._entered: Counter[State] = Counter()
        self._refused: tuple[str, ...] = ()  # by the system, to the control process
        self._recorded = 0  # the run that is being recorded
        self._settling = 0.0  # errors of its motion count from then on [s]
        self._lab = Backend(bench, self.ring)
        self._control: ControlHost | None = None
        self._watchdog = threading.Thread(target=self._watch_time, name="watchdog")

    def open(self) -> None:
        """Start every process; once."""
        one_thread_each()
        if self._folder is not None:
            self.recording = LiveRecording(self.ring, self.bench.robot, self._folder, self.bench.clock)
        self._lab.open()
        self._control = self._start_control()
        self._watchdog.start()

    def wait_ready(self, timeout: float, since: int = 0) -> None:
        """Wait until telemetry has gone beyond row `since`, or until stages wait for a person to home them.

        Raises:
            CtrError: it does not, in `timeout` [s].
        """
        deadline = self._clock.now() + timeout
        while self._state is not State.CONNECTED and (
            self.ring.written <= since or int(self.ring.counters[STATE]) == State.HOMED
        ):
            if self._state is State.FAULT:
                raise CtrError(f"the station did not come up: {self._cause}")
            if self._clock.now() > deadline:
                trouble = "; ".join(device.text for device in self._devices if device.text) or self._state.name
                raise CtrError(f"the station did not come up within {timeout:g} s: {trouble}")
            self._clock.sleep(0.02)

    def status(self) -> Status:
        """The present state, timing and newest telemetry."""
        counters, numbers = self.ring.counters, self.ring.numbers
        row = self.ring.latest()
        groups = {} if row is None else {name: self.channels.of(row, name) for name in self.channels.groups}
        with self._lock:
            # A dead process cannot say so itself.
            state = self._state if self._state in (State.OFF, State.FAULT) else State(int(counters[STATE]))
            return Status(
                state, self._cause if state in (State.HOLD, State.STOPPED, State.FAULT) else "", self._run_id(),
                self._title, Phase(int(counters[PHASE])) if int(counters[RUN]) == self._run else Phase.NONE,
                float(numbers[PROGRESS]), self._clock.now() - float(numbers[HEARTBEAT]), self.ring.timing(), groups,
                self._devices, self._warnings(), self._reserved,
            )  # fmt: skip

    def _warnings(self) -> tuple[str, ...]:
        stuck = (STUCK_TEXT,) if self.ring.counters[STUCK] else ()
        return (*self.bench.warnings, *self._refused, *stuck)

    def pids(self) -> dict[str, int]:
        """Number of every process that lives."""
        found = {"station": os.getpid()}
        if self._control is not None and self._control.alive:
            found["control"] = self._control.pid
        if self._lab.pid is not None:
            found["lab"] = self._lab.pid
        if self.recording is not None:
            found["recorder"] = self.recording.pid
        return found

    def entered(self, state: State) -> int:
        """How often that state has been entered."""
        return self._entered[state]

    # What may be asked

    def start(
        self,
        task: Task,
        load: Load,
        title: str,
        about: Mapping[str, Any] = MappingProxyType({}),
        faults: Sequence[LabFault] = (),
    ) -> str:
        """Start a run; its id.

        Args:
            task: what to do.
            load: on the virtual lab's tip during the motion.
            title: of the run.
            about: what else its recording says about it.
            faults: of the virtual lab's devices, their times counted from the motion's start.

        Raises:
            RefusedError: the state does not allow it, or a procedure is on.
            ConfigError: faults are asked of devices that are real.
            RecordingError: it cannot be recorded.
        """
        self._check_free()
        self._lab.check(faults)
        after(self.status().state, Event.START)
        number = next(self._runs)
        if self.recording is not None:
            name = f"{self._session}-{number}"
            known = {
                "run": name, "title": title, "seed": self.bench.seed, "clock_rate": self._clock.rate,
                "lab": self.bench.lab.model_dump(mode="json"),
            }  # fmt: skip
            self.recording.begin(name, task.duration, {**known, **about})
            self._recorded = number
        self._settling = about.get("settings", {}).get("settling", settling_time(task.duration))
        try:
            return self._begin(number, task, RunEffects(load, tuple(faults)), title)
        except RefusedError:
            self._end_recording(State.STOPPED, "it was refused after all")
            raise

    def visit(self, task: Task, title: str) -> str:
        """Start a step of the procedure that has the station to itself; its id.

        It is not recorded, and what hangs at the tip stays there.

        Raises:
            RefusedError: the state does not allow it.
        """
        return self._begin(next(self._runs), task, RunEffects(None), title)

    def reserve(self, why: str) -> None:
        """From now on only `visit` moves anything, until `release`; STOP and reset are as always.

        Args:
            why: is told whoever is refused.

        Raises:
            RefusedError: not READY, or reserved already.
        """
        self._check_free()
        after(self.status().state, Event.START)
        with self._lock:
            self._reserved = why

    def release(self) -> None:
        """Everybody may move the robot again."""
        self._lab.prepare(RunEffects())
        with self._lock:
            self._reserved = ""

    def stop(self) -> str:
        """Stop every axis; always accepted. What a person should know about it; empty when it is done."""
        if self._control is None or not self._control.alive:
            stopped = "" if self._control is None else self._control.stop_stages()
            return stopped or "there is no control process and nothing that moves"
        try:
            self._ask(Event.STOP)
        except RefusedError as error:
            return f"{error}; the stop is the next thing that it does"
        return ""

    def reset(self) -> None:
        """A person has seen the fault, stop or hold; processes that have died are started anew.

        Raises:
            RefusedError: there is nothing to reset.
            CtrError: they do not come back.
        """
        if self._control is None or (self._control.alive and self._lab.alive):
            self._ask(Event.RESET)
            return
        if self._control.alive:
            self._control.kill()  # the devices it has open are gone
        self._control.close()
        if not self._lab.alive:
            self._lab.open()
        self.ring.clear_timing()
        since = self.ring.written
        with self._lock:
            self._cause, self._state, self._run, self._title, self.task = "", State.OFF, 0, "", None
        self._control = self._start_control()
        self.wait_ready(60.0, since)

    def connect(self) -> None:
        """Find the devices, after they were given up.

        Raises:
            RefusedError: not OFF, or a procedure is on.
        """
        self._check_free()
        self._ask(Event.CONNECT)

    def home(self) -> None:
        """Home every stage; a person has said that the way is clear.

        Raises:
            RefusedError: neither CONNECTED nor READY, a procedure is on, or the stages cannot.
        """
        self._check_free()
        self._ask(Event.HOME)

    def tare(self) -> None:
        """Make what the force sensors feel zero.

        Raises:
            RefusedError: not READY, or a procedure is on.
        """
        self._check_free()
        self._ask("tare")

    def jog(self, space: Literal["joints", "tip"], velocity: Array) -> None:
        """Move by hand for the next 0.3 s: (n,) [rad/s or m/s] joints or (3,) [m/s] tip.

        Raises:
            RefusedError: not READY, or a procedure is on.
        """
        self._check_free()
        self._ask("jog", space=space, velocity=velocity)

    def operator_gone(self) -> None:
        """Nobody commands any more; as configured, a run that is on goes on or is held."""
        if self.bench.on_operator_loss == "hold" and self.status().state is State.RUNNING:
            cause = "the operator has gone; this station holds a run then (on_operator_loss = 'hold')"
            with contextlib.suppress(RefusedError):  # it has just ended
                self._ask(Event.HOLD, cause=cause)

    def apply_load(self, load: Load) -> None:
        """Put a load on the virtual lab's tip, now; the next motion brings its own."""
        self._lab.apply_load(load)

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Let these faults of the virtual lab's devices happen from now on; none: clear all."""
        self._lab.inject(faults)

    def close(self) -> None:
        """End the control process, its axes stopped, then the lab, and remove the shared memory."""
        self._closing.set()
        if self._control is not None:
            self._control.close()
        self._lab.close()
        if self._watchdog.is_alive():
            self._watchdog.join(timeout=self._clock.real(3.0))
        if self.recording is not None:
            self.recording.close()
        self._flight_recorder.close()
        self.ring.close(remove=True)

    def _ask(self, what: Any, **about: Any) -> None:
        """Have the control process do something."""
        if self._control is None:
            raise RefusedError("the station was not started: there is no control process")
        self._control.ask(what, **about)

    def _check_free(self) -> None:
        if self._reserved:
            raise RefusedError(self._reserved)

    def _begin(self, number: int, task: Task, effects: RunEffects, title: str) -> str:
        """Have a task carried out; its id."""
        before = self._lab.prepare(effects)
        try:
            self._ask(Event.START, task=task, run=number)
        except RefusedError:
            self._lab.prepare(before)
            raise
        with self._lock:
            self._run, self._title, self.task = number, title, task
            return self._run_id()

    # Processes

    def _run_id(self) -> str:
        return f"{self._session}-{self._run}" if self._run else ""

    def _start_control(self) -> ControlHost:
        return ControlHost(self.bench, self.ring, self._lab.devices, self._hear, self._ended)

    def _ended(self, ending: Ending) -> None:
        """The control process has ended unasked: the stages have been stopped, the run is marked."""
        with self._lock:
            # What it has said last is the cause, if it was a fault.
            said = self._cause if self._state is State.FAULT else ending.how
            self._state = State.FAULT
            self._cause = "; ".join(part for part in (said, ending.stopped, "reset to start it anew") if part)
        self._entered[State.FAULT] += 1
        self._flight_recorder.state(State.FAULT, self._cause)
        self._end_recording(State.FAULT, self._cause, interrupted=True)
        self._lab.motion(None)

    def _hear(self, message: Said) -> None:
        with self._lock:
            if isinstance(message, DeviceReport):
                self._devices = message.devices
                return
            if isinstance(message, Refused):
                self._refused = message.warnings
                for text in message.warnings:
                    self._flight_recorder.note("warning", text)
                return
            changed = self._state is not message.state
            self._state, self._cause = message.state, message.cause
        if changed:
            self._entered[message.state] += 1
            self._flight_recorder.state(message.state, message.cause)
        if changed and self.recording is not None:
            text = f"{message.state.name}{message.cause and ': '}{message.cause}"
            bad = message.state in (State.HOLD, State.FAULT)
            self.recording.say(self._time(), "state", text, bad=bad)
        if message.run == self._recorded and message.state is not State.RUNNING:
            self._end_recording(message.state, message.cause)
        begun = self._lab.motion(message.motion_start)
        if begun and message.motion_start is not None and self.recording is not None:
            start = self._time() + message.motion_start - self._clock.now()
            self.recording.moving(start, self._settling)

    def _end_recording(self, state: State, cause: str, *, interrupted: bool = False) -> None:
        if self.recording is None or not self._recorded:
            return
        self._recorded = 0
        if interrupted:
            self.recording.interrupted(cause)
        else:
            self.recording.end(state, cause)

    def _time(self) -> float:
        """Time of the newest telemetry [s]."""
        row = self.ring.latest()
        return 0.0 if row is None else float(row[0])

    def _watch_time(self) -> None:
        """Show the control process that this one lives; end it when it hangs."""
        if self.bench.fifo:
            ask_for_fifo(WATCHER_PRIORITY)
        while not self._closing.wait(self._clock.real(LOOK)):
            numbers = self.ring.numbers
            numbers[STATION_HEARTBEAT] = self._clock.now()
            ticked, control = float(numbers[HEARTBEAT]), self._control
            if control is None:
                continue
            # The first ticks of a new installation compile what they meet.
            patience = HUNG if self._entered[State.READY] else FIRST_TICKS
            if ticked > 0.0 and self._clock.now() - ticked > patience and control.alive:
                with self._lock:
                    self._state, self._cause = State.FAULT, f"the control loop has not ticked for {patience:g} s"
                control.kill()
            if self._recorded and self.recording is not None and (problem := self.recording.problem()):
                self._recorded = 0
                # A run that is not recorded is worth nothing: end it safely.
                control.hold(f"the recording has ended: {problem}")
