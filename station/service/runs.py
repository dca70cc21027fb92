"""Numbered runs of a station, of which one at a time is active, and their recordings.

A separate thread controls the recorder's process, so that no other thread waits.
"""

import itertools
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from station.camera.host import Cameras
from station.config.loads import Load, NoLoad
from station.config.regions import mesh_hashes
from station.config.robots import RobotFile
from station.control.child_process import is_alive
from station.control.clock import StationClock
from station.control.messages import StateNotice
from station.control.realtime import Life, life
from station.control.ring import RECORDER_HEARTBEAT, Ring
from station.control.states import RefusedError, State
from station.control.task import MotionTask
from station.devices.interfaces import with_details
from station.lab.faults import LabFault
from station.recording.foxglove import ERROR, INFO, MARK, RecordedEvent
from station.recording.history import RunError, RunHistory
from station.recording.recorder import START_TIMEOUT_S, Recorder
from station.recording.recover import recover
from station.recording.run_folder import VIDEOS_FOLDER, free_space_problem
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import PARTIAL_SUFFIX
from station.service.station_file import Rig

_NO_LOAD = NoLoad()


@dataclass(frozen=True)
class StartRequest:
    """Task of a run, load and faults of the virtual lab during the run, and metadata of the recording."""

    task: MotionTask
    title: str  #: human-readable name of the run
    load: Load | None = _NO_LOAD  #: load at the tip of the virtual lab's robot during the motion; None: no change
    faults: tuple[LabFault, ...] = ()  #: faults of the virtual lab's devices; their times count from the motion's start
    counted_from: float = 0.0  #: errors of the tip before this time of the motion are not counted [s]
    warnings: tuple[str, ...] = ()  #: warnings for the operator, shown after acceptance
    about: Mapping[str, Any] = field(default_factory=dict[str, Any])  #: further metadata of the recording
    recorded: bool = True  #: whether the run is recorded


class RunEnd(NamedTuple):
    """End of a run: READY if it is complete, otherwise the state in which it ended."""

    state: State
    cause: str  #: cause of HOLD, STOPPED or FAULT; empty after a complete run


@dataclass(frozen=True)
class RunRequest:
    """Start request with the number and the id of its run."""

    number: int  #: number of the run, from 1
    id: str  #: id of the run, also the name of its recording
    start: StartRequest
    #: set when the control process reports the end of the run, or has ended; a later reset does not change it
    end: Future[RunEnd] = field(default_factory=Future[RunEnd], compare=False)


#: Time without a heartbeat after which the recorder counts as hung [s]; shorter than the 8 s of rows in the ring.
RECORDER_TIMEOUT_S = 3.0


class LiveRecording:
    """Owner of one recorder; its methods are thread-safe. Interrupted runs of a killed station are recovered first."""

    def __init__(self, ring: Ring, robot: RobotFile, runs: Path, clock: StationClock, videos: float = 0.0) -> None:
        self.runs = runs
        self._videos = videos  # largest growth of the cameras' videos [bytes/s]
        #: Folders of recovered runs, and messages about runs that cannot be recovered or removed.
        self.recovered, self.not_recoverable = recover(runs)
        try:
            RunHistory(runs).purge()
        except RunError as error:  # too many deleted runs do not prevent the start; the operator is informed
            self.not_recoverable.append(str(error))
        self._ring, self._clock = ring, clock
        ring.numbers[RECORDER_HEARTBEAT], self._started = 0.0, clock.now()
        self._recorder = Recorder(ring, robot, runs, clock)
        # Use one thread, because the recorder answers one request at a time.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._check: Future[None] | None = None
        self._ending: Future[None] | None = None
        self._problem = self._lost = ""

    @property
    def pid(self) -> int:
        """Process ID of the recorder."""
        return self._recorder.child.pid

    def begin(
        self, name: str, duration: float, counted_from: float, metadata: Mapping[str, Any], until: float = math.inf
    ) -> str:
        """Start a recording of about `duration` [s]; return its unique name, derived from `name`.

        Errors of the tip before the time `counted_from` [s] of the motion are not counted.

        Raises:
            RecordingError: the disk is full, or the recorder cannot start by `until` on the station's clock [s].
        """
        problem = self._stall() or free_space_problem(self.runs, duration, self._videos)
        if problem:
            raise RecordingError(problem)
        self._problem, self._lost = "", ""
        self._ring.clear_timing()
        started = self._thread.submit(self._recorder.begin, name, metadata, counted_from)
        try:
            return started.result(
                min(max(0.0, self._clock.real(until - self._clock.now())), threading.TIMEOUT_MAX)
            ).name
        except TimeoutError:
            if not started.cancel():
                self._ending = self._thread.submit(self._drop, started)
            raise RecordingError(
                "the recorder did not start in time (it restarts, or the disk is slow); try again"
            ) from None

    @property
    def stiffness(self) -> list[list[float | None]] | None:
        """Stiffness at each point that the running palpation has measured so far [N/m]; None: no palpation."""
        return self._recorder.stiffness

    @property
    def finishing(self) -> bool:
        """Whether the run has ended but the recorder has not finished its recording yet."""
        return self._ending is not None and not self._ending.done()

    def add_event(self, time: float, kind: str, text: str, *, bad: bool = False) -> None:
        """Record an event at `time` of the telemetry [s]; `bad` marks the event as an error."""
        self._thread.submit(self._recorder.event, RecordedEvent(time, kind, text, ERROR if bad else INFO))

    def end(self, state: State, cause: str) -> None:
        """End the recording of a run that ended in this state; do not wait for the recording's end."""
        label = RunOutcome.COMPLETE if state is State.READY else RunOutcome.STOPPED
        self._ending = self._thread.submit(self._end, label, cause, self._numbers_now())

    def interrupted(self, cause: str) -> None:
        """End the recording of a run whose control process has died; do not wait for its end."""
        self._ending = self._thread.submit(self._end, RunOutcome.INTERRUPTED, cause, self._numbers_now())

    def problem(self) -> str:
        """Return why the present recording has failed; empty without a problem. Do not wait for the recorder."""
        if still := self._stall():
            return still
        if self._check is None or self._check.done():
            self._check = self._thread.submit(self._check_recorder)
        return self._problem

    def lost(self) -> str:
        """Return why the last recording could not be finished, only at the first call; empty without a problem."""
        lost, self._lost = self._lost, ""
        return lost

    @property
    def healthy(self) -> bool:
        """Whether the recorder runs and does not hang; waits up to `RECORDER_TIMEOUT_S` for its heartbeat."""
        child = self._recorder.child
        if not child.alive or life(child.pid) is not Life.RUNS:  # also a killed process that has not ended yet
            return False
        starting = not self._ring.numbers[RECORDER_HEARTBEAT] and self._clock.now() - self._started < START_TIMEOUT_S
        return starting or self.finishing or is_alive(self._ring, RECORDER_HEARTBEAT, self._clock, RECORDER_TIMEOUT_S)

    def close(self) -> None:
        """End the recorder; it finishes the present recording and labels it *interrupted*."""
        self._thread.submit(self._recorder.close).result()
        self._thread.shutdown()

    def kill(self) -> None:
        """Kill the recorder; its data can be recovered later, and `close` does not wait for it."""
        self._recorder.child.kill()
        self._recorder.child.ended()

    def _stall(self) -> str:
        """Return why the recorder counts as hung; empty while it has a heartbeat, starts or finishes a recording."""
        beat = float(self._ring.numbers[RECORDER_HEARTBEAT])
        if not beat or self.finishing or self._clock.now() - beat <= RECORDER_TIMEOUT_S:
            return ""
        return f"the recorder has not responded for {RECORDER_TIMEOUT_S:g} s; reset the station to restart it"

    def _check_recorder(self) -> None:
        self._problem = self._problem or self._recorder.trouble()

    def _numbers_now(self) -> dict[str, Any]:
        """Return the loop's timing statistics of this run, before the next run clears them."""
        ring = self._ring
        counts = {"late_counts": ring.late.tolist(), "tick_counts": ring.busy.tolist()}
        return {"timing": {**ring.timing()._asdict(), **counts}}

    def _drop(self, started: Future[Path]) -> None:
        """Finish a recording that started too late for its run."""
        if started.exception() is None:
            self._end(RunOutcome.STOPPED, "the recording started too late, and its run was not executed", {})

    def _end(self, label: RunOutcome, cause: str, numbers: Mapping[str, Any]) -> None:
        try:
            self._recorder.end(label, cause, numbers)
        except RecordingError as error:
            self._problem = self._problem or str(error)
            why = self._recorder.trouble() or str(error)
            self._lost = f"the recording of the last run was not finished: {why}"


def _time_of_day() -> datetime:
    return datetime.now().astimezone()


class Runs:
    """Register of runs and owner of their recording; its methods are thread-safe."""

    def __init__(
        self,
        bench: Rig,
        ring: Ring,
        folder: Path | None,
        cameras: Cameras | None = None,
        time_of_day: Callable[[], datetime] = _time_of_day,
    ) -> None:
        """Prepare runs that are recorded in `folder` with the `cameras`, if given; `open` starts the recorder.

        `time_of_day` returns the time for the names of session and runs; a run starts later than its session.
        """
        self._time_of_day = time_of_day
        self._cameras = cameras
        self._bench, self._ring, self._folder = bench, ring, folder
        self.session = f"{time_of_day():%Y%m%d-%H%M%S}"
        self._numbers = itertools.count(1)
        self._lock, self._renewing = threading.Lock(), threading.Lock()
        self._prepared: RunRequest | None = None
        self.current: RunRequest | None = None  #: present run or last run; None before the first run
        self._moving = 0  # number of the run that the control process has reported as RUNNING; 0: none
        self._recorded: RunRequest | None = None  # run whose recording is in progress
        self.recorder: LiveRecording | None = None  #: owner of the recorder; None without a folder or before `open`

    def open(self) -> None:
        """Start the recorder's process, if there is a folder."""
        if self._folder is not None:
            self.recorder = LiveRecording(
                self._ring, self._bench.robot, self._folder, self._bench.clock, self._bench.video_bytes_per_s
            )

    def renew(self) -> bool:
        """Replace a recorder that has died or hangs; return whether it was replaced."""
        with self._renewing:
            old = self.recorder
            if old is None or old.healthy:
                return False
            old.kill()
            self._end_recording()
            self.open()
            old.close()
            return True

    @property
    def recording(self) -> bool:
        """Whether a run is being recorded, or its recording is being finished."""
        return self._recorded is not None or (self.recorder is not None and self.recorder.finishing)

    @property
    def stiffness(self) -> list[list[float | None]] | None:
        """Stiffness at the points that the present palpation has measured [N/m]; None: no palpation is recorded."""
        return self.recorder.stiffness if self.recorder is not None and self._recorded is not None else None

    def prepare(self, start: StartRequest, until: float = math.inf) -> RunRequest:
        """Number a start request and start its recording; the caller must then call `accepted` or `refused`.

        Raises:
            RecordingError: the recording cannot start by `until` on the station's clock [s].
        """
        number = next(self._numbers)
        run = RunRequest(number, f"{self._time_of_day():%Y%m%d-%H%M%S}-{number}", start)
        if self.recorder is not None and start.recorded:
            known = {
                "title": start.title, "seed": self._bench.seed, "clock_rate": self._bench.clock.rate,
                "lab": self._bench.lab.model_dump(mode="json") if self._bench.devices is None
                else {"title": self._bench.title},
            }  # fmt: skip
            if meshes := mesh_hashes(self._bench.keep_out):
                known["meshes"] = meshes
            # The recorder chooses the name: another station with the same folder may use the run's name already.
            about = {**known, **start.about}
            name = self.recorder.begin(run.id, start.task.duration, start.counted_from, about, until)
            self._recorded = run = replace(run, id=name)
            if self._cameras is not None:
                self._cameras.record(self.recorder.runs / (name + PARTIAL_SUFFIX) / VIDEOS_FOLDER)
        with self._lock:
            self._prepared = run  # the run's first state notice may arrive before the answer to its start
        return run

    def accepted(self, run: RunRequest) -> None:
        """Set the present run after the control process has accepted it."""
        with self._lock:
            self.current = run

    def refused(self, run: RunRequest) -> None:
        """Forget a run that the control process has refused."""
        with self._lock:
            self._prepared = None
        if self._recorded is run:
            self._finish(State.STOPPED, "the control process refused the run")

    def forget(self) -> None:
        """Forget the runs of a control process that has ended."""
        self._end_unfinished("the control process was restarted")
        with self._lock:
            self._prepared = self.current = None

    def present(self, number: int) -> RunRequest | None:
        """Return the prepared run if it has the `number` that the control process executes; else the present run."""
        with self._lock:
            prepared = self._prepared
            return prepared if prepared is not None and prepared.number == number else self.current

    def find(self, number: int) -> StartRequest | None:
        """Return the start request of the newest or present run if this run has the number; otherwise None."""
        with self._lock:
            return next((run.start for run in (self._prepared, self.current) if run and run.number == number), None)

    def state_changed(self, notice: StateNotice) -> None:
        """Add a change of the station's state to the recording of the run."""
        if self.recorder is not None:
            cause = with_details(notice.cause, notice.details)
            text = f"{notice.state.name}{cause and ': '}{cause}"
            self.recorder.add_event(self._time(), "state", text, bad=notice.state in (State.HOLD, State.FAULT))

    def mark(self, text: str) -> None:
        """Mark the present moment of the run in its recording.

        Raises:
            RefusedError: no run is being recorded.
        """
        if self.recorder is None or self._recorded is None:
            raise RefusedError("no run is being recorded; start a run to mark a moment of it")
        self.recorder.add_event(self._time(), MARK, text)

    def on_state(self, notice: StateNotice) -> None:
        """End the run and its recording if the notice reports the end of the run."""
        cause = with_details(notice.cause, notice.details)
        with self._lock:
            run = next((run for run in (self._prepared, self.current) if run and run.number == notice.run), None)
            if notice.state is State.RUNNING:
                self._moving = notice.run
            elif run is not None and self._moving == run.number and not run.end.done():
                run.end.set_result(RunEnd(notice.state, notice.cause))
        if self._recorded is not None and notice.run == self._recorded.number and notice.state is not State.RUNNING:
            self._finish(notice.state, cause or notice.contact)

    def interrupted(self, cause: str) -> None:
        """End a run whose control process has died, and its recording."""
        self._end_unfinished(cause)
        if self.recorder is not None and self._recorded is not None:
            self._end_recording()
            self.recorder.interrupted(cause)

    def problem(self) -> str:
        """Return why the recording of the present run has failed, only at the first call; empty without a problem.

        Without a present recording, return why the last recording could not be finished.
        """
        if self.recorder is None:
            return ""
        if self._recorded is None:
            return self.recorder.lost()
        if not (problem := self.recorder.problem()):
            return ""
        self._end_recording()
        return f"the recording has ended: {problem}"

    def close(self) -> None:
        """End the recorder; it finishes the present recording and labels it *interrupted*."""
        with self._renewing:
            recording, self.recorder = self.recorder, None
        if recording is not None:
            recording.close()

    def _end_unfinished(self, cause: str) -> None:
        """End the runs that have not ended before their control process."""
        with self._lock:
            for run in (self._prepared, self.current):
                if run is not None and not run.end.done():
                    run.end.set_result(RunEnd(State.FAULT, cause))

    def _finish(self, state: State, cause: str) -> None:
        if self.recorder is not None:
            self.recorder.end(state, cause)
        self._end_recording()

    def _end_recording(self) -> None:
        self._recorded = None
        if self._cameras is not None:
            self._cameras.record(None)

    def _time(self) -> float:
        """Return the time of the newest telemetry [s]."""
        row = self._ring.latest()
        return 0.0 if row is None else float(row[0])
