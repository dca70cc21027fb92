"""Calibration of a running station: one procedure at a time; only the procedure moves the robot.

The station moves from pose to pose, the operator attaches weights, and a child process plans the poses and computes
the results. STOP ends the procedure.
"""

import contextlib
import shutil
import threading
import time
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import computed_field

from core.errors import CtrError
from core.robot.robot import Array
from station.calibration.catalogue import PROCEDURES, known_weights
from station.calibration.files import new_folder
from station.calibration.procedure import (
    SWING_DECAY_S,
    AbortedError,
    Answer,
    GoToPose,
    OperatorPrompt,
    Step,
    SwingRecord,
    measurement_of,
    rest_orders,
    task,
)
from station.calibration.worker import CalibrationJob, JobFinished, WorkerHost
from station.config.loads import ConstantLoad, NoLoad
from station.config.strict import Strict, check
from station.control.states import RefusedError, State
from station.control.task import MotionTask
from station.devices.aurora.tracker import TrackerMounting
from station.devices.config import Mount
from station.lab.aurora_coil import assumed_mounting
from station.service.calibration_choice import CalibrationChoice
from station.service.camera_calibration import CameraCalibration
from station.service.permits import Permit
from station.service.runs import StartRequest
from station.service.station_file import Rig
from station.service.supervisor import Supervisor

#: States in which the station may be started again.
RESTING_STATES = (State.OFF, State.CONNECTED, State.READY, State.HOLD, State.STOPPED, State.FAULT)
#: Interval between two checks of the station's state while a procedure waits [s].
POLL_INTERVAL_S = 0.05
#: States in which a procedure continues; any other state ends it.
OPERATING_STATES = (State.READY, State.RUNNING)


class SessionStage(StrEnum):
    """Stage of a calibration procedure."""

    THINKING = "thinking"  #: poses are being selected, or results computed
    MOVING = "moving"  #: the robot moves, or rests at a pose for a measurement
    ASKING = "asking"  #: the procedure waits for the operator
    DONE = "done"
    ABORTED = "aborted"
    FAILED = "failed"  #: the measurements do not determine the result


class SessionReport(Strict):
    """Progress or result of the present or last calibration procedure."""

    what: str
    """name of the procedure"""
    effort: float
    """factor that multiplies the default number of poses"""
    stage: SessionStage
    """stage of the procedure"""
    done: float = 0.0
    """completed part, 0 ... 1"""
    message: str
    """present activity, or the reason of the end"""
    instruction: str = ""
    """instruction for the operator; empty when there is none"""
    weight: float = 0.0
    """known weight at the tip, or weight to attach now [N]"""
    elapsed: float = 0.0
    """time since the start [s]"""
    left: float = 0.0
    """expected remaining time [s]"""
    result: str = ""
    """name of the folder with the result; empty without a result"""

    @computed_field
    @property
    def on(self) -> bool:
        """Whether the procedure has not ended."""
        return self.stage in (SessionStage.THINKING, SessionStage.MOVING, SessionStage.ASKING)

    def now(self, **changes: Any) -> "SessionReport":
        """Return a copy of the report with these changes."""
        return self.model_copy(update=changes)


class CalibrationSession:
    """One procedure: a separate thread calls `run`; other threads may read `report` and call `done` and `abort`."""

    def __init__(self, supervisor: Supervisor, job: CalibrationJob, permit: Permit) -> None:
        self._supervisor, self._job, self._clock = supervisor, job, supervisor.bench.clock
        self._permit = permit  # a STOP or a reset after the request voids this permit, which ends the procedure
        self._controller = supervisor.bench.controlled(supervisor.bench.controller)
        self._confirmed, self._abort = threading.Event(), ""
        self._prompting = threading.Lock()  # a confirmation counts only for the instruction that is open
        self._start_time, self._end_time = self._clock.now(), 0.0
        self._expected = PROCEDURES[job.what].expected(job.effort, len(job.weights))
        self._zero: float | None = None  # telemetry's time at the first measurement [s]
        self._attached = 0.0  # weight at the tip that the operator has confirmed [N]
        self._visits = 0
        self._now = SessionReport(what=job.what, effort=job.effort, stage=SessionStage.THINKING, message="starting")

    @property
    def report(self) -> SessionReport:
        """Progress or result of the calibration procedure."""
        now, elapsed = self._now, (self._end_time or self._clock.now()) - self._start_time
        if not now.on:
            return now.now(elapsed=elapsed)
        # The elapsed time includes waiting times for the operator, so the estimate does not use the elapsed time.
        return now.now(elapsed=elapsed, left=self._expected * (1.0 - now.done))

    def done(self) -> None:
        """Confirm that the operator has carried out the instruction.

        Raises:
            RefusedError: the procedure is not waiting for the operator.
        """
        with self._prompting:
            if self._now.stage is not SessionStage.ASKING or self._confirmed.is_set():
                raise RefusedError("no procedure waits for the operator now")
            self._confirmed.set()

    def abort(self, cause: str) -> None:
        """End the procedure at its next check; motion is stopped and no result is kept.

        Raises:
            RefusedError: the procedure has ended.
        """
        if not self._now.on:
            raise RefusedError("no procedure is running")
        self._abort = cause

    def run(self) -> None:
        """Execute the procedure until it is done, aborted or failed."""
        ending, why = SessionStage.FAILED, "the procedure has ended unexpectedly"
        try:
            with contextlib.closing(WorkerHost(self._job, self._supervisor.ring, self._clock)) as guide:
                step = self._next_step(guide, "selecting the first poses")
                while not isinstance(step, JobFinished):
                    guide.answer(self._execute(step))
                    step = self._next_step(guide, "computing results from the measurements")
            self._show(
                SessionStage.MOVING, 1.0, "the results are ready; returning to the start pose", self._job.folder.name
            )
            ending, why = SessionStage.DONE, ""
            # The results are valid even if the robot does not return.
            with contextlib.suppress(AbortedError, RefusedError):
                self._go_back()
        except (AbortedError, RefusedError) as error:
            ending, why = SessionStage.ABORTED, str(error)
        except CtrError as error:
            ending, why = SessionStage.FAILED, str(error)
        finally:
            self._finish(ending, why)

    def _finish(self, ending: SessionStage, why: str) -> None:
        if self._supervisor.status().state is State.RUNNING:
            self._supervisor.stop()
        if ending is not SessionStage.DONE:
            shutil.rmtree(self._job.folder, ignore_errors=True)
        if weight := max(self._now.weight, self._attached):
            self._supervisor.lab.apply_load(NoLoad())  # in the virtual lab; the operator removes a real weight
            why = f"{why}; a weight of {weight:g} N may be attached to the tip: remove it"
        self._end_time = self._clock.now()
        self._now = self._now.now(stage=ending, message=why, instruction="", weight=0.0, left=0.0)

    # Steps

    def _next_step(self, guide: WorkerHost, message: str) -> Step | JobFinished:
        """Wait for the next step of the procedure."""
        self._show(SessionStage.THINKING, self._now.done, message)
        while (step := guide.receive(POLL_INTERVAL_S)) is None:
            self._check_state()
        return step

    def _execute(self, step: Step) -> Answer:
        if isinstance(step, OperatorPrompt):
            self._prompt_operator(step)
            return None
        self._visits += 1
        activity = f"pose {self._visits}" if isinstance(step, GoToPose) else "all joints swing back and forth"
        self._show(SessionStage.MOVING, step.done, activity)
        before = self._joints()
        rows = self._rows(task(step, self._controller), f"calibrate {self._job.what}, {activity}")
        answer = measurement_of(self._supervisor.channels, rows, step, before, self._controller)
        if isinstance(answer, SwingRecord):
            return answer
        # Count times from the first measurement, because the fit of the sensors' drift needs time differences only.
        self._zero = answer.time if self._zero is None else self._zero
        return answer._replace(time=answer.time - self._zero)

    def _prompt_operator(self, step: OperatorPrompt) -> None:
        with self._prompting:
            self._confirmed.clear()
            self._now = self._now.now(
                stage=SessionStage.ASKING,
                done=step.done,
                message="waiting for the operator",
                instruction=step.text,
                weight=step.weight,
            )
        while not self._confirmed.wait(POLL_INTERVAL_S):
            self._check_state()
        self._attached = step.weight
        # In the virtual lab this attaches the weight; with real devices it does nothing.
        self._supervisor.lab.apply_load(ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad())
        self._show(SessionStage.MOVING, step.done, "waiting until the weight is at rest")
        end = self._clock.now() + SWING_DECAY_S
        while self._clock.now() < end:
            self._check_state()
            time.sleep(POLL_INTERVAL_S)

    def _rows(self, what: MotionTask, title: str) -> Array:
        """Execute a task to its end and return its telemetry (m, channels)."""
        self._check_state()
        ring = self._supervisor.ring
        kept, since = list[Array](), ring.written
        self._supervisor.start_step(StartRequest(what, title, load=None, recorded=False), self._permit)
        while True:
            time.sleep(POLL_INTERVAL_S)
            running = self._check_state() is State.RUNNING  # before reading the rows, to include the last ones
            rows, since, _ = ring.read(since)
            kept.append(rows)
            if not running:
                return np.concatenate(kept)

    def _go_back(self) -> None:
        """Move back to the start pose of the procedure."""
        start = self._job.start
        self._rows(
            MotionTask(self._controller, rest_orders(start.size), 0.0, start, loaded=True),
            f"calibrate {self._job.what}, returning",
        )

    # Progress and state

    def _show(self, stage: SessionStage, done: float, message: str, result: str = "") -> None:
        self._now = self._now.now(stage=stage, done=done, message=message, instruction="", result=result)

    def _check_state(self) -> State:
        """Return the station's state after checking that the procedure may continue.

        Raises:
            AbortedError: the state ends the procedure, or the operator has aborted it.
            VoidError: the station was stopped or reset after the request for the procedure.
        """
        if self._abort:
            raise AbortedError(self._abort)
        status = self._supervisor.status()
        if status.state not in OPERATING_STATES:
            raise AbortedError(f"the station is {status.state.name}: {status.cause or 'the cause is in the log'}")
        self._permit.check(f"calibrate {self._job.what}")
        return status.state

    def _joints(self) -> Array:
        return self._supervisor.status().values["joints"]


class LiveCalibration:
    """Calibration procedures on one station; its methods are thread-safe."""

    def __init__(self, supervisor: Supervisor, folder: Path, choice: CalibrationChoice | None = None) -> None:
        """Prepare calibrations whose results are written to a new folder inside `folder`, and applied to `choice`."""
        self.supervisor, self.folder = supervisor, folder
        self.choice = choice or CalibrationChoice()  #: calibration that the station starts with
        self.cameras = CameraCalibration(supervisor, folder)
        self._session: CalibrationSession | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def report(self) -> SessionReport | None:
        """Report of the present or last calibration procedure; None before the first one."""
        return None if self._session is None else self._session.report

    def start(
        self, what: str, effort: float = 1.0, weights: tuple[float, ...] = (), permit: Permit | None = None
    ) -> None:
        """Start a procedure; the caller confirms that the whole workspace of the tubes is free.

        Args:
            what: name in the catalogue.
            effort: factor that multiplies the default number of poses.
            weights: calibration weights that the operator can attach to the tip [N]; empty: the usual ones.
            permit: permit of the request; a later STOP or reset ends the procedure.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the station lacks a device of the procedure, is not READY, or a procedure runs.
            ConfigError: the tracker's pose in the station's file is invalid, the folder cannot be written, or a weight
                exceeds what the robot bears.
        """
        if missing := PROCEDURES[what].missing(self.supervisor.bench.present):
            raise RefusedError(f"'calibrate {what}' {missing}, which this bench does not have")
        permit = permit or self.supervisor.permit()
        with self._lock:
            self.supervisor.reserve(f"'calibrate {what}' has reserved the robot: wait for its end, or abort it", permit)
            if self._thread is not None:
                self._thread.join()  # the previous procedure has already released the robot
            try:
                job = _job(self.supervisor, self.folder, what, effort, weights)
                permit.check("calibrate")
                self._session = CalibrationSession(self.supervisor, job, permit.lasting())
            except BaseException:
                self.supervisor.release()
                raise
            self._thread = threading.Thread(target=self._run, args=(self._session,), name="calibration")
            self._thread.start()

    @property
    def clearing(self) -> Literal["tracker", "tubes"]:
        """Procedure that the page recommends if the model's tip is too far from the tracker's tip."""
        known = self.supervisor.bench.calibration
        return "tracker" if known is not None and known.fitted_tubes else "tubes"

    def choose(self, folder: Path | None, permit: Permit) -> None:
        """Apply the calibration in `folder`, or undo the last choice (None), while nothing moves; the station restarts.

        Raises:
            VoidError: a STOP or a reset came after the request.
            RefusedError: the robot moves or is reserved, or there is nothing to undo.
            ConfigError: the station cannot use this calibration, or its file cannot be written.
        """
        self.supervisor.check("apply", RESTING_STATES, permit)
        if folder is None:
            self.choice.undo()
        else:
            self.choice.apply(folder)

    def done(self) -> None:
        """Confirm that the operator has carried out the instruction.

        Raises:
            RefusedError: no procedure is waiting for the operator.
        """
        self._on().done()

    def abort(self, cause: str = "aborted by the operator") -> None:
        """End the present calibration procedure; motion is stopped and no result is kept.

        Raises:
            RefusedError: no procedure is running.
        """
        self._on().abort(cause)

    def close(self) -> None:
        """Abort the present calibration procedure and wait for its end."""
        self.cameras.close()
        with contextlib.suppress(RefusedError):
            self.abort("the station has ended")
        if self._thread is not None:
            self._thread.join()

    def _on(self) -> CalibrationSession:
        if self._session is None:
            raise RefusedError("no procedure is running")
        return self._session

    def _run(self, session: CalibrationSession) -> None:
        try:
            session.run()
        finally:
            self.supervisor.release()


def assumed_mount(bench: Rig) -> TrackerMounting:
    """Return the assumed pose of the tracker, which defines the world frame of the telemetry."""
    if bench.calibration is not None and bench.calibration.registration is not None:
        return bench.calibration.registration
    if bench.devices is None or bench.devices.tracker is None:
        return assumed_mounting(bench.lab)
    mount = check(Mount, bench.devices.tracker.get("mount", {}), "devices.tracker.mount")
    return TrackerMounting(mount.rotation, np.array(mount.position))


def _job(supervisor: Supervisor, folder: Path, what: str, effort: float, weights: tuple[float, ...]) -> CalibrationJob:
    bench, known = supervisor.bench, supervisor.bench.best_known_robot
    calibration, now, mount = bench.calibration, datetime.now().astimezone(), assumed_mount(bench)
    return CalibrationJob(
        what, effort, known_weights(known, weights), known, np.array(bench.park), mount,
        bench.title, bench.seed if bench.devices is None else None, supervisor.simulated,
        now.isoformat(timespec="seconds"),
        new_folder(folder, f"{what}-{now:%Y%m%d-%H%M%S}"), None if calibration is None else calibration.folder,
        0.0 if calibration is None else calibration.latency, bench.present.sensors, bench.robot,
    )  # fmt: skip
