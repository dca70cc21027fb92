"""Live recorder: a separate process that copies the telemetry ring to the disk every 0.2 s until the end of a run.

The recorder only reads the rows of the ring, so it does not affect the control loop. It counts rows that were
overwritten before it could read them. When its parent process is gone, it finishes the recording as interrupted and
ends.
"""

import contextlib
import os
import select
import signal
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.motions import PalpateMotion
from station.config.robots import RobotFile
from station.control.child_process import ChildProcess, takes_message
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.guard import BackgroundWatch, Rank
from station.control.realtime import set_process_name
from station.control.ring import RECORDER_HEARTBEAT, Ring
from station.control.task import Phase
from station.control.telemetry import Channels
from station.recording.drawing import Drawing
from station.recording.foxglove import WARNING, RecordedEvent
from station.recording.press_outcome import PalpationSoFar, force_not_reached, obstacle_of, press_of, press_outcome
from station.recording.read import MAX_SUMMARY_ROWS, read_case
from station.recording.recover import recover
from station.recording.run_folder import LIVE_CASE, RunFolder
from station.recording.run_outcome import RecordingError, RunOutcome, motion_errors
from station.recording.writer import FLUSH_INTERVAL_S, CaseWriter

#: Phases of the control task that belong to a run; jogging does not.
RUN_PHASES = (Phase.APPROACHING, Phase.SETTLING, Phase.MOVING)
#: Longest time to wait for the first reply of the recorder's process, which has to start, and for any later reply [s].
START_TIMEOUT_S, REPLY_TIMEOUT_S = 60.0, 10.0
#: Kind of a motion that sweeps one joint, so it has no desired path of the tip and no tip errors.
JOINT_SWEEP = "joint_sweep"
#: Interval between two reports of the stiffness that a palpation has found [s].
REPORT_INTERVAL_S = 1.0


class RunRows:
    """Selects the rows of one run up to the end of its motion, block by block.

    After the motion the load is removed, in a virtual lab without delay. The tip moves then, but this motion is not
    part of the run.
    """

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._started = False
        self.over = False  #: whether the run has ended; later rows do not belong to it
        self.motion_start: float | None = None  #: time of the first row in phase MOVING [s]

    def take(self, rows: Array) -> Array:
        """Return the rows (m, channels) of the next block (n, channels) that belong to the run or precede it."""
        if self.over:
            return rows[:0]
        phases = self._channels.of(rows, "phase")[:, 0]
        for number, phase in enumerate(phases.tolist()):
            if phase in RUN_PHASES:
                self._started = True
                if phase == Phase.MOVING and self.motion_start is None:
                    self.motion_start = float(rows[number, 0])
            elif self._started:
                self.over = True
                return rows[:number]
        return rows


class StartRecording(NamedTuple):
    """Request to the recorder: start a recording."""

    name: str
    metadata: Mapping[str, Any]
    counted_from: float  #: time after the motion's start from which errors count [s]


class EndRecording(NamedTuple):
    """Request to the recorder: finish the recording."""

    label: RunOutcome
    cause: str
    numbers: Mapping[str, Any]  #: further numbers that are added to the summary


class RecorderReply(NamedTuple):
    """Reply of the recorder to a request."""

    path: Path | None  #: folder of the run; None: the request failed
    problem: str


class RecorderProgress(NamedTuple):
    """Unsolicited message of the recorder: the stiffness that a palpation has found so far."""

    stiffness: list[list[float | None]]  #: stiffness of each place, row by row [N/m]; None: not known yet


class RecorderFault(NamedTuple):
    """Unsolicited message of the recorder: the recording has ended without a request, e.g. because of a full disk."""

    text: str


class Recorder:
    """Interface through which the parent process uses the recorder. Only one thread may use it at a time."""

    def __init__(self, ring: Ring, robot: RobotFile, runs: Path, clock: StationClock = REAL_TIME_CLOCK) -> None:
        """Start the process of the recorder.

        Args:
            ring: telemetry to record, owned by the caller.
            robot: robot of the telemetry.
            runs: folder of the runs.
            clock: clock of the station.
        """
        self._ring, self._clock = ring, clock
        self._trouble = ""
        self.stiffness: list[list[float | None]] | None = None  #: stiffness found so far; None: no palpation runs
        self.child = ChildProcess(run_recorder, ring.name, robot, runs, clock, name="recorder")
        self._replied = False

    def begin(self, name: str, metadata: Mapping[str, Any], counted_from: float = 0.0) -> Path:
        """Start to record a run until the end of its motion, and return the final path of its folder.

        The recording starts with the next row after the reply. It cannot start with the request, because a recorder
        that is just starting may take longer to reply than the ring keeps rows.

        The tip errors count from `counted_from` [s] after the start of the motion.

        Raises:
            RecordingError: the folder cannot be created, or the recorder has ended.
        """
        self._trouble, self.stiffness = "", None
        request = StartRecording(name, metadata, counted_from)
        path = self._request(request, REPLY_TIMEOUT_S if self._replied else START_TIMEOUT_S)
        self._replied = True
        return path

    def event(self, event: RecordedEvent) -> None:
        """Record an event of the run; without an active recording the event is dropped."""
        self.child.send(event)  # if the recorder has ended, the method `trouble` reports it later

    def end(self, label: RunOutcome, cause: str = "", numbers: Mapping[str, Any] | None = None) -> Path:
        """Finish the recording with the rows that are in the ring, and return the run's folder.

        Raises:
            RecordingError: the recording cannot be finished or has already ended, or the recorder has ended.
        """
        return self._request(EndRecording(label, cause, numbers or {}), REPLY_TIMEOUT_S)

    def trouble(self) -> str:
        """Return why the recording has ended without a request, or an empty text; never blocks."""
        try:
            while self.child.pipe.poll():
                self._note(self.child.pipe.recv())
        except (EOFError, OSError):
            self._trouble = self._trouble or self._gone()
        return self._trouble

    def close(self) -> None:
        """End the process of the recorder, which finishes an active recording as interrupted."""
        self.child.close(self._clock.real(REPLY_TIMEOUT_S))

    def _request(self, request: StartRecording | EndRecording, timeout: float) -> Path:
        deadline = self._clock.now() + timeout
        try:
            self.child.pipe.send(request)
            while self.child.pipe.poll(self._clock.real(max(0.0, deadline - self._clock.now()))):
                message = self.child.pipe.recv()
                if isinstance(message, RecorderReply):
                    if message.path is None:
                        raise RecordingError(message.problem)
                    return message.path
                self._note(message)
        except (EOFError, OSError):
            raise RecordingError(self._gone()) from None
        # Kill the process: otherwise its late reply would be mistaken for the reply to the next request.
        self.child.kill()
        raise RecordingError(
            f"the recorder did not reply within {timeout:g} s and was ended (a slow disk?); reset starts a new one"
        )

    def _note(self, message: RecorderReply | RecorderProgress | RecorderFault) -> None:
        if isinstance(message, RecorderFault):
            self._trouble = message.text
        elif isinstance(message, RecorderProgress):
            self.stiffness = message.stiffness

    def _gone(self) -> str:
        how = self.child.ended(self._clock.real(1.0))
        return f"the recorder ended {how}; reset starts a new one and recovers the recording"


def run_recorder(
    ring_name: str, robot: RobotFile, runs: Path, clock: StationClock, pipe: Connection, parent: int
) -> None:
    """Main function of the recorder's process."""
    set_process_name("ctr-recorder")
    signals: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    channels = Channels(robot.robot())
    ring = Ring(len(channels), ring_name)
    _warm_up(robot, channels)
    watch = BackgroundWatch(ring, Rank.RECORDER, clock)
    recording: _Recording | None = None
    # `Connection.poll` creates a selector for every call and would need a tenth of the recorder's processor time.
    poller = select.poll()
    poller.register(pipe.fileno(), select.POLLIN)
    due = clock.now() + FLUSH_INTERVAL_S
    try:
        while not signals and os.getppid() == parent:
            ring.numbers[RECORDER_HEARTBEAT] = clock.now()
            if poller.poll(max(0.0, 1e3 * clock.real(due - clock.now()))):
                message: StartRecording | EndRecording | RecordedEvent | None = pipe.recv()
                if message is None:
                    break
                if isinstance(message, StartRecording):
                    recording, reply = _start(message, recording, robot, channels, runs, ring)
                    ring.numbers[RECORDER_HEARTBEAT] = clock.now()  # from now on the parent checks this heartbeat
                    pipe.send(reply)
                elif isinstance(message, EndRecording):
                    reply = recording.end(message) if recording else RecorderReply(None, "no recording is active")
                    recording = None
                    ring.numbers[RECORDER_HEARTBEAT] = clock.now()  # finishing the recording may have taken long
                    pipe.send(reply)
                elif recording is not None:
                    recording.writer.event(message)
                continue
            # If the computer was suspended, the missed intervals are skipped.
            due = max(due + FLUSH_INTERVAL_S, clock.now())
            if recording is not None:
                try:
                    recording.copy()
                    recording.report(pipe)
                except RecordingError as error:
                    recording.give_up(str(error))
                    recording = None
                    pipe.send(RecorderFault(str(error)))
    except (EOFError, OSError):
        pass  # the parent process has ended; an active recording is finished below
    finally:
        try:
            if recording is not None:
                recording.end(EndRecording(RunOutcome.INTERRUPTED, "the station process is gone", {}))
        finally:
            watch.close()
            ring.close(remove=os.getppid() != parent)


def _warm_up(robot: RobotFile, channels: Channels) -> None:
    """Load the compiled code of the robot's model in advance, because loading would delay the first rows too long."""
    row = np.zeros(len(channels))
    channels.of(row, "joints")[:] = [0.5 * (joint.lower + joint.upper) for joint in robot.joints]
    Drawing(robot.robot(), channels.all, 1).messages(row, 0)


class _Recording:
    """Recording that is active in the process of the recorder."""

    def __init__(
        self, folder: RunFolder, writer: CaseWriter, request: StartRecording, ring: Ring, channels: Channels
    ) -> None:
        self.writer = writer
        self._run_rows = RunRows(channels)
        self._folder, self._ring, self._request = folder, ring, request
        self._next = ring.written
        self._cpu = time.process_time()
        self._missed = 0
        self._last = 0.0
        press = press_of(request.metadata.get("settings", {}))
        self._palpation = PalpationSoFar(press, channels) if isinstance(press, PalpateMotion) else None
        self._reported, self._found = 0.0, list[list[float | None]]()

    def copy(self) -> None:
        """Copy the new rows of the run from the telemetry ring to the disk."""
        rows, self._next, missed = self._ring.read(self._next)
        if missed and not self._run_rows.over:
            self._missed += missed
            text = f"{missed} rows were overwritten before the recorder read them"
            self.writer.event(RecordedEvent(self._last, "recorder", text, WARNING, {"missed": missed}))
        rows = self._run_rows.take(rows)
        if len(rows):
            self._last = float(rows[-1, 0])
            if self._palpation is not None:
                self._palpation.add(rows)
        self.writer.write(rows)

    def report(self, pipe: Connection) -> None:
        """Send the stiffness that a palpation has found, if it is new; never wait for a parent that does not read."""
        start = self._run_rows.motion_start
        if self._palpation is None or start is None or self._last < self._reported + REPORT_INTERVAL_S:
            return
        self._reported, found = self._last, self._palpation.stiffness(start)
        if found != self._found and takes_message(pipe):
            self._found = found
            pipe.send(RecorderProgress(found))

    def end(self, end: EndRecording) -> RecorderReply:
        """Finish the recording and return the reply."""
        try:
            self.copy()
            self.writer.close(end.label, end.cause, missed=self._missed, cpu_s=time.process_time() - self._cpu)
            errors, missed = self._errors()
            cause = "; ".join(filter(None, (end.cause, missed if end.label is RunOutcome.COMPLETE else "")))
            self._folder.finish(self._summary(end.label, cause, {**end.numbers, **errors}))
        except RecordingError as error:
            self.give_up(str(error))
            return RecorderReply(None, str(error))
        return RecorderReply(self._folder.path, "")

    def give_up(self, problem: str) -> None:
        """End the recording because the disk is full; the file is completed now, or by the next recovery."""
        with contextlib.suppress(RecordingError):
            self._folder.finish(self._summary(RunOutcome.INCOMPLETE, problem, {}))

    def _errors(self) -> tuple[Mapping[str, Any], str]:
        """Return the errors of tip and force, and why a desired force was not reached.

        Both are empty if the motion did not settle or has no path of the tip.
        """
        start, first = self._run_rows.motion_start, self._request.counted_from
        if start is None:
            return {}, ""
        motion = {"motion_start": start, "motion_s": round(self._last - start + PERIOD_S, 3), "counted_from_s": first}
        settings = self._request.metadata.get("settings", {})
        if settings.get("trajectory", {}).get("kind") == JOINT_SWEEP:
            return motion, ""
        of = read_case(self._folder.case(LIVE_CASE), MAX_SUMMARY_ROWS).of
        found = {**motion, **motion_errors(of, start, first)}
        if "force_max_N" in found and (press := press_of(settings)) is not None:
            found |= press_outcome(of, press, obstacle_of(settings), start, first)
            return found, force_not_reached(of, press, start)
        return found, ""

    def _summary(self, label: RunOutcome, cause: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
        metadata = self._request.metadata
        known = {key: metadata[key] for key in ("experiment", "title", "seed", "clock_rate") if key in metadata}
        done = label is RunOutcome.COMPLETE
        return {
            **known, "started": self.writer.started, "label": label, "cause": cause, "completed": done,
            "cases": {LIVE_CASE: {"completed": done, "cause": cause, **numbers}},
        }  # fmt: skip


def _start(
    request: StartRecording, active: _Recording | None, robot: RobotFile, channels: Channels, runs: Path, ring: Ring
) -> tuple[_Recording | None, RecorderReply]:
    if active is not None:
        return active, RecorderReply(None, "another recording is active")
    try:
        folder = RunFolder(runs, request.name)
    except RecordingError as error:
        return None, RecorderReply(None, str(error))
    try:
        about = {**request.metadata, "run": folder.path.name, "robot": robot.model_dump(mode="json")}
        writer = CaseWriter(folder.case(LIVE_CASE), robot.robot(), channels.all, about)
    except RecordingError as error:
        folder.let_go()
        recover(runs)
        return None, RecorderReply(None, str(error))
    return _Recording(folder, writer, request, ring, channels), RecorderReply(folder.path, "")
