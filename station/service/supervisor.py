"""Supervisor of a running station: it executes commands and reacts to the reports of the station's processes.

A station consists of processes, runs and a state. The station process accesses a device only to stop the stages after
the control process has died.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array
from station.camera.host import Cameras
from station.config.loads import Load
from station.control.messages import CommandKind, CommandRefused, DeviceReport, StateNotice
from station.control.process import ring_width
from station.control.realtime import move_off_core
from station.control.ring import STATE, Ring
from station.control.states import RefusedError, State, Transition, next_state
from station.control.task import Space
from station.control.telemetry import Channels
from station.devices.interfaces import is_simulated, with_details
from station.lab.faults import LabFault
from station.recording.run_outcome import RecordingError
from station.service.audit import Audit, FlightRecorder
from station.service.control_host import NOTHING_MOVES, ControlReport, ExitReport, NoReply
from station.service.fallback_stop import StopOutcome
from station.service.permits import Permit, Permits, VoidError
from station.service.processes import CONTROL_LABEL, ProcessSupervisor
from station.service.runs import RunRequest, Runs, StartRequest
from station.service.station_file import Rig
from station.service.status import StateMonitor, StationStatus

T = TypeVar("T")


class SingleFlight(Generic[T]):
    """Callable that runs a function once for simultaneous calls; every caller gets its result or exception."""

    def __init__(self, function: Callable[[], T]) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._in_progress: Future[T] | None = None

    def __call__(self) -> T:
        """Return the result of a new call or of the call in progress; thread-safe."""
        mine = Future[T]()
        with self._lock:
            in_progress = self._in_progress
            if in_progress is None:
                self._in_progress = mine
        if in_progress is not None:
            return in_progress.result()
        try:
            mine.set_result(self._function())
        except BaseException as error:
            mine.set_exception(error)
        finally:
            with self._lock:
                self._in_progress = None
        return mine.result()


#: Longest time until a restarted control process is ready after a reset, including the loading of code [s].
RESTART_TIMEOUT_S = 120.0


class Supervisor:
    """One station, which is OFF and has no processes until `open`; its methods are thread-safe."""

    def __init__(self, bench: Rig, folder: Path | None = None, audit: Audit | None = None) -> None:
        """Prepare a station that records runs in `folder` and changes of state in `audit`, if they are given."""
        self.bench, self._clock = bench, bench.clock
        self.robot = bench.best_known_robot.robot()
        self.channels = Channels(self.robot)
        self.statics = Statics(self.robot)
        self.ring = Ring(ring_width(bench.robot))
        width = ring_width(bench.robot)
        self.cameras = Cameras(
            bench.cameras,
            bench.known_cameras,
            bench.robot,
            self.ring,
            width,
            bench.clock,
            bench.seed,
            bench.tracking_cameras,
        )
        self._runs = Runs(bench, self.ring, folder, self.cameras)
        self._state = StateMonitor(self.ring, self.channels, bench.clock)
        self._flight_recorder = FlightRecorder(self.ring, self.channels, audit, folder, self._runs.session)
        self._processes = ProcessSupervisor(bench, self.ring, self._on_report, self._on_exit, self._runs.problem)
        self._reset_once = SingleFlight(self._reset)
        self._permits = Permits(self.ring, bench.clock)
        self._reset_permit = self._permits.issue().lasting()  # permit of the newest request for a reset
        self._starting = threading.Lock()  # locked from the last check of the state until the answer to the start
        self._reserved = ""  # reason why only a calibration procedure may move the robot

    def open(self) -> None:
        """Start every process of the station; call this once."""
        self._runs.open()
        if (recorder := self._runs.recorder) is not None:
            for folder in recorder.recovered:
                self._flight_recorder.note("recovered", f"run {folder.name}, which had been interrupted")
            for sentence in recorder.not_recoverable:
                self._flight_recorder.note("not recovered", sentence)
        self.cameras.open()
        self._state.begin()
        self._processes.open()
        self.cameras.start()

    def wait_started(self, timeout: float) -> None:
        """Wait as `wait_ready` does, or until an operator stops the start, after which an operator connects again.

        Raises:
            CtrError: as `wait_ready`, without a STOP or a reset.
        """
        start = self._permits.issue().lasting()
        try:
            self.wait_ready(timeout)
        except CtrError:
            try:
                start.check("start")
            except VoidError:
                return
            raise

    def wait_ready(self, timeout: float, since: int = 0) -> None:
        """Wait until telemetry is beyond row `since`, or until the stages wait to be homed.

        Raises:
            CtrError: neither happens within `timeout` [s], or the station enters FAULT or ends.
        """
        deadline = self._clock.now() + timeout
        while self._state.reported is not State.CONNECTED and (
            self.ring.written <= since or int(self.ring.counters[STATE]) == State.HOMED
        ):
            if self._state.reported is State.FAULT:
                raise CtrError(f"the station did not start: {self._state.full_cause}")
            if self._processes.closing:
                raise RefusedError("the station is ending")
            if self._state.reported is State.OFF and self._state.cause:
                raise CtrError(f"the station did not start: {self._state.full_cause}; connect to continue")
            if self._clock.now() > deadline:
                raise CtrError(f"the station did not start within {timeout:g} s: {self._state.device_problems()}")
            self._clock.sleep(0.02)
        move_off_core(self.bench.core, (pid for name, pid in self.pids().items() if name != "control"))

    def status(self) -> StationStatus:
        """Return the status of the station: state, run, devices, timing and newest telemetry."""
        warnings = (*self.bench.warnings, *self._processes.warnings)
        while True:  # once more if a run starts meanwhile, because its state must not be shown with the run before it
            number = self._state.run_number
            run = self._runs.present(number)
            status = self._state.snapshot(run, self._runs.recording, self._reserved, warnings)
            if number == self._state.run_number:
                return status

    def pids(self) -> dict[str, int]:
        """Return the process ID of every process that runs, by name."""
        recorder = self._runs.recorder
        return self._processes.pids() | self.cameras.pids() | ({} if recorder is None else {"recorder": recorder.pid})

    def entered(self, state: State) -> int:
        """Return how often the station has entered a state."""
        return self._state.entered[state]

    # Commands

    def permit(self, gone: Callable[[], bool] | None = None) -> Permit:
        """Return the permit of a request that arrives now.

        `gone` returns whether the client has disconnected. Commands that move the robot, and a reset, have an argument
        `permit` for the permit. Without this argument a command gets a new permit.
        """
        return self._permits.issue(gone)

    def check(self, event: Transition, permit: Permit) -> None:
        """Check permit, reservation and state, which refuses a command before the slow check of its motion.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the command, or a procedure has reserved the robot.
        """
        permit.check(event)
        self._check_free()
        next_state(self._state.state, event)

    def start(self, start: StartRequest, permit: Permit) -> RunRequest:
        """Start a run, unless a procedure has reserved the robot.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the run, or a procedure has reserved the robot.
            ConfigError: the run contains simulated faults, but the devices are real.
            RecordingError: the run cannot be recorded.
        """
        self._check_free()
        return self.start_step(start, permit)

    def start_step(self, start: StartRequest, permit: Permit) -> RunRequest:
        """Start a step of the procedure that has reserved the robot.

        Raises:
            VoidError, RefusedError, ConfigError, RecordingError: as in `start`.
        """
        self._processes.lab.check(start.faults)
        return self._start_run(Transition.START, start, permit)

    def reserve(self, why: str, permit: Permit) -> None:
        """Reserve the robot for a procedure: only `start_step` moves it until `release`. STOP and reset still work.

        Args:
            why: reason for refusing other commands.
            permit: permit of the procedure's request.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the station is not READY, or the robot is already reserved.
        """
        self.check(Transition.START, permit)
        self._reserved = why

    def release(self) -> None:
        """End the reservation; every operator may move the robot again."""
        self._reserved = ""

    def stop(self, cause: str = "stopped by the operator") -> StopOutcome:
        """Stop every axis in any state; return whether every axis has stopped, and what the operator must know.

        A STOP voids every earlier request for a motion or a reset.
        """
        self._permits.void(cause, stop=True)
        control = self._processes.control
        return NOTHING_MOVES if control is None else control.stop(cause)

    def reset(self, who: str = "the operator", permit: Permit | None = None) -> str:
        """Reset the station after a person has checked the cause; restart processes that have died or hang.

        Simultaneous resets are merged into one. A reset voids every earlier request for a motion.

        Returns:
            Human-readable list of restarted processes; empty when none was restarted.

        Raises:
            VoidError: a STOP came after the request.
            RefusedError: there is nothing to reset.
            CtrError: a restarted process does not become ready.
        """
        self._reset_permit = (permit or self.permit()).lasting()
        self._permits.void(f"reset by {who}", stop=False)
        return self._reset_once()

    def _reset(self) -> str:
        recorder = ("the recorder",) if self._runs.renew() else ()
        failed = self._processes.failed()
        if not failed:
            try:
                self._send(Transition.RESET, self._reset_permit)
            except NoReply:
                failed = self._processes.failed() or (CONTROL_LABEL,)
            except RefusedError:
                if not recorder:
                    raise
        if failed:
            self._reset_permit.check(Transition.RESET)
            self._processes.end_failed(failed)
            self.ring.clear_timing()
            since = self.ring.written
            self._state.forget()
            self._runs.forget()
            self._processes.restart()
            self.wait_ready(RESTART_TIMEOUT_S, since)
        restarted = " and ".join((*recorder, *failed))
        if restarted:
            self._flight_recorder.note("reset", f"restarted: {restarted}")
        return restarted and f"restarted: {restarted}"

    def connect(self, permit: Permit | None = None) -> None:
        """Search for the devices and connect them.

        Raises:
            RefusedError: the station is not OFF, or a procedure has reserved the robot.
        """
        self._send_if_free(Transition.CONNECT, permit)

    def home(self, then: StartRequest | None = None, permit: Permit | None = None) -> None:
        """Home every stage, then start the run `then`; the caller confirms that the path is clear.

        Raises:
            RefusedError: the state is neither CONNECTED nor READY, a procedure has reserved the robot, or the stages
                cannot be homed.
        """
        if then is None:
            self._send_if_free(Transition.HOME, permit)
            return
        permit = permit or self.permit()
        self.check(Transition.HOME, permit)
        self._start_run(Transition.HOME, then, permit)

    def tare(self, permit: Permit | None = None) -> None:
        """Tare the force sensors.

        Raises:
            RefusedError: the station is not READY, or a procedure has reserved the robot.
        """
        self._send_if_free("tare", permit)

    def mark(self, text: str) -> None:
        """Mark the present moment of the run in its recording.

        Raises:
            RefusedError: no run is being recorded.
        """
        self._runs.mark(text)

    def jog(self, space: Space, velocity: Array, permit: Permit | None = None) -> None:
        """Jog for the next 0.3 s: joints (n,) [rad/s or m/s], tip (3,) [m/s], or the tip's direction (3,) [rad/s].

        Raises:
            RefusedError: the station is not READY, a procedure has reserved the robot, or the tip's direction is not
                controlled.
        """
        self._send_if_free("jog", permit, space=space, velocity=velocity)

    def set_stiffness(self, axes: tuple[float, float, float], permit: Permit | None = None) -> None:
        """Change the stiffness of the tip along its axes [N/m] in the present motion.

        Raises:
            RefusedError: the present motion has no stiffness, no motion runs, a procedure has reserved the robot, or
                the stiffness is too low for the delay of the line.
        """
        self._send_if_free("stiffness", permit, stiffness=axes)

    def operator_gone(self) -> None:
        """React to the loss of the operator: the present run continues or ends in HOLD, as configured."""
        if self.bench.on_operator_loss == "hold" and self._state.state is State.RUNNING:
            cause = "the operator has disconnected; this station then ends a run in HOLD (on_operator_loss = 'hold')"
            with contextlib.suppress(RefusedError):  # the refusal means that the run has just ended
                self._send(Transition.HOLD, cause=cause)

    def apply_load(self, load: Load) -> None:
        """Apply a load to the virtual lab's tip now; the load of the next motion replaces this load."""
        self._processes.lab.apply_load(load)

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Inject faults into the virtual lab's devices from now on; an empty sequence clears all faults."""
        self._processes.lab.inject(faults)

    def end_control(self) -> StopOutcome:
        """Stop every axis and end the control process; nothing moves after this call.

        Returns:
            Outcome of stopping the stages.
        """
        self.cameras.end_streams()
        return self._processes.end_control()

    def close(self) -> None:
        """Stop every axis, end the control process and the lab, and remove the shared memory."""
        self._processes.close()
        self.cameras.close()
        self._runs.close()
        self._flight_recorder.close()
        self.ring.close(remove=True)

    def _check_free(self) -> None:
        if self._reserved:
            raise RefusedError(self._reserved)

    def _send_if_free(self, what: CommandKind, permit: Permit | None, **about: Any) -> None:
        self._check_free()
        self._send(what, permit or self.permit(), **about)

    def _send(self, what: CommandKind, permit: Permit | None = None, **about: Any) -> None:
        control = self._processes.control
        if control is None:
            raise RefusedError("the station was not started: there is no control process")
        control.send_command(what, permit, **about)

    @property
    def simulated(self) -> bool:
        """Whether the devices belong to the station's virtual lab, or one of them reports that it is simulated."""
        return self.bench.devices is None or any(is_simulated(device.details) for device in self._state.devices)

    def _start_run(self, what: Transition, start: StartRequest, permit: Permit) -> RunRequest:
        """Prepare a run and let the control process execute it, now or after homing; one call at a time."""
        with self._starting:
            permit.check(what)
            next_state(self._state.state, what)
            start = replace(start, about={"simulated": self.simulated, **start.about})
            try:
                run = self._runs.prepare(start, permit.until)
            except RecordingError:
                permit.check(what)  # raises if a STOP arrived or the recorder took too long
                raise
            try:
                self._send(what, permit, task=start.task, run=run.number)
            except RefusedError:
                self._runs.refused(run)
                raise
            self._runs.accepted(run)
        return run

    # Reports of the processes

    def _on_report(self, message: ControlReport) -> None:
        match message:
            case DeviceReport():
                self._state.devices = message.devices
            case CommandRefused():
                self._state.refusals = message.warnings
                for text in message.warnings:
                    self._flight_recorder.note("warning", text)
            case StateNotice():
                self._on_state(message)
            case StopOutcome():
                self._state.set_stop_outcome(message.text)
                self._flight_recorder.note("stages", message.text)

    def _on_state(self, notice: StateNotice) -> None:
        if self._state.set_reported(notice.state, notice.cause, notice.details):
            self._flight_recorder.state(notice.state, with_details(notice.cause, notice.details))
            self._runs.state_changed(notice)
        self._runs.on_state(notice)
        self._processes.lab.motion(self._runs.find(notice.run), notice.motion_start)

    def _on_exit(self, ending: ExitReport) -> None:
        """React to the unexpected end of the control process; the `ControlHost` is already stopping the stages."""
        self._state.fault(ending.how, ending.stages, ending.details)
        cause = self._state.full_cause
        self._flight_recorder.state(State.FAULT, cause)
        self._runs.interrupted(cause)
        self._processes.lab.motion(None, None)
