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
from typing import Generic, NamedTuple, TypeVar

from core.control.setpoint_request import SetpointRequest
from core.errors import CtrError
from core.model.statics import Statics
from station.camera.host import Cameras
from station.config.controllers import ControllerFile, default_controller
from station.config.motions import TipMotion
from station.control.commands import Command, ControlCommand, Execute, Hold, HomeStages, LoopCommand, Reset, Stop
from station.control.messages import CommandRefused, DeviceReport, StateNotice
from station.control.process import ring_width
from station.control.realtime import move_off_core
from station.control.ring import STATE, Ring
from station.control.states import RefusedError, State, check_state
from station.control.task import StreamRequest
from station.control.telemetry import Channels
from station.devices.interfaces import is_simulated, with_details
from station.recording.run_outcome import RecordingError
from station.service.audit import Audit, FlightRecorder
from station.service.commands import MotionSettings, Start, StationCommand
from station.service.control_host import NOTHING_MOVES, ControlHost, ControlReport, ExitReport, NoReply
from station.service.fallback_stop import StopOutcome
from station.service.permits import Permit, Permits, VoidError
from station.service.processes import CONTROL_LABEL, GUARD_LABEL, ProcessSupervisor
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


class Outcome(NamedTuple):
    """Outcome of a command that was accepted."""

    run: RunRequest | None = None  #: run that the command has started; None: none
    note: str = ""  #: message for the operator; empty if there is nothing to report
    confirmed: bool = True  #: whether every axis has confirmed a STOP

    @property
    def started(self) -> RunRequest:
        """Run of a command that starts one."""
        assert self.run is not None, "the command starts a run"  # noqa: S101
        return self.run


#: Longest time until a restarted control process is ready after a reset, including the loading of code [s].
RESTART_TIMEOUT_S = 120.0
_RESET = Reset()


class Supervisor:
    """One station, which is OFF and has no processes until `open`; its methods are thread-safe."""

    def __init__(self, bench: Rig, folder: Path | None = None, audit: Audit | None = None) -> None:
        """Prepare a station that records runs in `folder` and changes of state in `audit`, if they are given."""
        self.bench, self._clock = bench, bench.clock
        self.robot = bench.best_known_robot.robot()
        self.channels = Channels(self.robot)
        self.statics = Statics(self.robot)
        width = ring_width(bench.robot)
        self.ring = Ring(width)
        self.cameras = Cameras(
            bench.cameras, bench.known_cameras, bench.robot, self.ring, width, bench.clock, bench.seed,
            bench.tracking_cameras,
        )  # fmt: skip
        self.runs = Runs(bench, self.ring, folder, self.cameras)  #: register of the runs
        self._state = StateMonitor(self.ring, self.channels, bench.clock)
        self._flight_recorder = FlightRecorder(self.ring, self.channels, audit, folder, self.runs.session)
        self._processes = ProcessSupervisor(bench, self.ring, self._on_report, self._on_exit, self.runs.problem)
        self.lab = self._processes.lab  #: virtual lab, which refuses faults if the devices are real
        self._reset_once = SingleFlight(self._reset)
        self._permits = Permits(self.ring, bench.clock)
        # The newest request for a reset, and its permit.
        self._reset_command, self._reset_permit = _RESET, self._permits.issue().lasting()
        self.settings = MotionSettings(controller=default_controller(bench.present))  #: for the next free motion
        self._changing = threading.Lock()  # locked while the settings change
        self._starting = threading.Lock()  # locked from the last check of the state until the answer to the start
        self._reserved = ""  # reason why only a calibration procedure may move the robot

    def open(self) -> None:
        """Start every process of the station; call this once."""
        self.runs.open()
        if (recorder := self.runs.recorder) is not None:
            for folder in recorder.recovered:
                self._flight_recorder.note("recovered", f"run {folder.name}, which had been interrupted")
            for sentence in recorder.not_recoverable:
                self._flight_recorder.note("not recovered", sentence)
        self.cameras.open()
        self._state.begin()
        self._processes.open()
        self.cameras.start()

    def wait_started(self, timeout: float) -> None:
        """Wait like `wait_ready`, but also return if a STOP or a reset ends the start; an operator then connects again.

        Raises:
            CtrError: as in `wait_ready`, unless a STOP or a reset came first.
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
        while True:  # repeat if a run starts meanwhile: its state must not be shown with the previous run
            number = self._state.run_number
            run = self.runs.present(number)
            status = self._state.snapshot(run, self.runs.recording, self._reserved, warnings)
            if number == self._state.run_number:
                return status

    def pids(self) -> dict[str, int]:
        """Return the process ID of every process that runs, by name."""
        recorder = self.runs.recorder
        return self._processes.pids() | self.cameras.pids() | ({} if recorder is None else {"recorder": recorder.pid})

    def entered(self, state: State) -> int:
        """Return how often the station has entered a state."""
        return self._state.entered[state]

    def change_settings(self, trajectory: TipMotion | None = None, controller: ControllerFile | None = None) -> None:
        """Change trajectory or controller of the next free motion.

        Raises:
            DescriptionError: the strategy is unknown, or a gain or bandwidth is out of range.
        """
        if controller is not None:
            self.bench.controlled(controller)
        with self._changing:
            self.settings = self.settings.changed_by(Start(trajectory=trajectory, controller=controller))

    # Commands

    def permit(self, gone: Callable[[], bool] | None = None) -> Permit:
        """Return the permit of a request that arrives now.

        `gone` returns whether the client has disconnected. A command without a permit gets a new one.
        """
        return self._permits.issue(gone)

    def check(self, what: str, states: Sequence[State], permit: Permit) -> None:
        """Check permit, reservation and state for the command `what`, before the slow check of its motion.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the command, or a procedure has reserved the robot.
        """
        permit.check(what)
        self._check_free()
        check_state(self._state.state, what, states)

    def send(self, command: Command, permit: Permit | None = None) -> Outcome:
        """Check and execute a command; page, scripts, run queue and streams all send their commands with this method.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the command, or a procedure has reserved the robot.
            CtrError: the command is not possible on this station; the text has the reason.
        """
        if isinstance(command, Stop):
            stopped = self.stop(command.cause)
            return Outcome(note=stopped.text, confirmed=stopped.confirmed)
        if isinstance(command, Reset):
            return Outcome(note=self.reset(command.who, permit, command))
        command.check(self.bench.robot)
        if isinstance(command, StationCommand):
            return Outcome(command.execute(self, permit or self.permit()))
        if isinstance(command, LoopCommand):
            self.command_control(command, permit)
        return Outcome()

    def send_setpoint(self, run: RunRequest, request: SetpointRequest | None) -> None:
        """Send a setpoint request to a streamed run; None: end the stream, and the tip comes to rest."""
        self.ring.write_request(StreamRequest(run.number, request))

    def command_control(self, command: ControlCommand, permit: Permit | None = None) -> None:
        """Send a command to the control process, unless a procedure has reserved the robot.

        Raises:
            VoidError, RefusedError: as in `send`.
        """
        self._check_free()
        self._control.send(command, (permit or self.permit()).on(self._reservation))

    def start(self, start: StartRequest, permit: Permit, *, home: bool = False) -> RunRequest:
        """Start a run, unless a procedure has reserved the robot; `home`: home every stage first.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the state does not allow the run, or a procedure has reserved the robot.
            ConfigError: the run contains simulated faults, but the devices are real.
            RecordingError: the run cannot be recorded.
        """
        self._check_free()
        return self.start_step(start, permit.on(self._reservation), home=home)

    def start_step(self, start: StartRequest, permit: Permit, *, home: bool = False) -> RunRequest:
        """Start a step of the procedure that has reserved the robot; simultaneous calls wait for each other.

        Raises:
            VoidError, RefusedError, ConfigError, RecordingError: as in `start`.
        """
        command = HomeStages if home else Execute
        self.lab.check(start.faults)
        with self._starting:
            permit.check(command.name)
            check_state(self._state.state, command.name, command.states)
            start = replace(start, about={"simulated": self.simulated, **start.about})
            try:
                run = self.runs.prepare(start, permit.until)
            except RecordingError:
                permit.check(command.name)  # raises if a STOP arrived or the recorder took too long
                raise
            try:
                self._control.send(command(replace(start.task, run=run.number)), permit)
            except RefusedError:
                self.runs.refused(run)
                raise
            self.runs.accepted(run)
        return run

    def reserve(self, why: str, permit: Permit) -> None:
        """Reserve the robot for a procedure: only `start_step` moves it until `release`. STOP and reset still work.

        Args:
            why: reason for refusing other commands.
            permit: permit of the procedure's request.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the station is not READY, or the robot is already reserved.
        """
        self.check("calibrate", Execute.states, permit)
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

    def reset(self, who: str = "the operator", permit: Permit | None = None, command: Reset = _RESET) -> str:
        """Reset the station after a person has checked the cause; restart processes that have died or hang.

        Simultaneous resets are merged into one. A reset voids every earlier request for a motion.

        Returns:
            Human-readable list of restarted processes; empty when none was restarted.

        Raises:
            VoidError: a STOP came after the request.
            RefusedError: there is nothing to reset.
            CtrError: a restarted process does not become ready.
        """
        command.check_fault(self._state.state)
        self._reset_command, self._reset_permit = command, (permit or self.permit()).lasting()
        self._permits.void(f"reset by {who}", stop=False)
        return self._reset_once()

    def _reset(self) -> str:
        renewed = {"the recorder": self.runs.renew(), GUARD_LABEL: self._processes.renew_guard()}
        helpers = tuple(name for name, new in renewed.items() if new)
        failed = self._processes.failed()
        if not failed:
            try:
                self._control.send(self._reset_command, self._reset_permit)
            except NoReply:
                failed = self._processes.failed() or (CONTROL_LABEL,)
            except RefusedError:
                if not helpers:
                    raise
        if failed:
            self._reset_command.check_fault(State.FAULT)
            self._reset_permit.check(Reset.name)
            self._processes.end_failed(failed)
            self.ring.clear_timing()
            since = self.ring.written
            self._state.forget()
            self.runs.forget()
            self._processes.restart()
            self.wait_ready(RESTART_TIMEOUT_S, since)
        restarted = " and ".join((*helpers, *failed))
        if restarted:
            self._flight_recorder.note("reset", f"restarted: {restarted}")
        return restarted and f"restarted: {restarted}"

    def operator_gone(self) -> None:
        """React to the loss of the operator: the present run continues or ends in HOLD, as configured."""
        if self.bench.on_operator_loss == "hold" and self._state.state is State.RUNNING:
            cause = "the operator has disconnected; this station then ends a run in HOLD (on_operator_loss = 'hold')"
            with contextlib.suppress(RefusedError):  # the refusal means that the run has just ended
                self._control.send(Hold(cause))

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
        self.runs.close()
        self._flight_recorder.close()
        self.ring.close(remove=True)

    def _reservation(self) -> str:
        """Return why only a procedure may move the robot now; empty if the robot is not reserved."""
        return self._reserved

    def _check_free(self) -> None:
        if self._reserved:
            raise RefusedError(self._reserved)

    @property
    def _control(self) -> ControlHost:
        """Host of the control process.

        Raises:
            RefusedError: there is no control process.
        """
        if self._processes.control is None:
            raise RefusedError("the station was not started: there is no control process")
        return self._processes.control

    @property
    def simulated(self) -> bool:
        """Whether the devices belong to the station's virtual lab, or one of them reports that it is simulated."""
        return self.bench.devices is None or any(is_simulated(device.details) for device in self._state.devices)

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
        self._state.contact = notice.contact
        if self._state.set_reported(notice.state, notice.cause, notice.details):
            self._flight_recorder.state(notice.state, with_details(notice.cause, notice.details))
            self.runs.state_changed(notice)
        self.runs.on_state(notice)
        self.lab.motion(self.runs.find(notice.run), notice.motion_start)

    def _on_exit(self, ending: ExitReport) -> None:
        """React to the unexpected end of the control process; the `ControlHost` is already stopping the stages."""
        self._state.fault(ending.how, ending.stages, ending.details)
        cause = self._state.full_cause
        self._flight_recorder.state(State.FAULT, cause)
        self.runs.interrupted(cause)
        self.lab.motion(None, None)
