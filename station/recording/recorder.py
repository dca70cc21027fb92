"""The live recorder: a process of its own that copies the telemetry ring to disk every 0.2 s, to the end of a run.

It only ever reads the ring's rows, so the control loop cannot feel it; what the ring has overwritten before it
was read is counted. When its parent is gone it finishes the recording as interrupted and ends.
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

from station.config.robots import RobotFile
from station.control.child import Child
from station.control.clock import REAL_TIME, StationClock
from station.control.realtime import show_as
from station.control.ring import RECORDER_HEARTBEAT, Ring
from station.control.telemetry import Channels
from station.recording.drawing import Drawing
from station.recording.events import WARNING, Event
from station.recording.label import Label, RecordingError
from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_folder import RunFolder
from station.recording.run_rows import RunRows
from station.recording.tracking_errors import motion_errors
from station.recording.writer import CaseWriter

#: A chunk is closed and handed to the operating system so often [s].
FLUSH = 0.2
#: The process has this long to begin and to finish a recording [s].
START_TIME, ANSWER_TIME = 60.0, 10.0
#: Of a longer run the errors are those of every second, third, ... tick.
MOST_ROWS = 1_000_000
#: Name of the only case of a live run.
CASE = "run"
#: A motion of a joint, which has no path for the tip.
SWEEP = "joint_sweep"


class Begin(NamedTuple):
    """Parent -> recorder."""

    name: str
    metadata: Mapping[str, Any]
    since: int  #: number of the first row
    counted_from: float  #: errors count from so long after the motion's start on [s]


class End(NamedTuple):
    """Parent -> recorder."""

    label: Label
    cause: str
    numbers: Mapping[str, Any]  #: what its summary says besides


class Answer(NamedTuple):
    """Recorder -> parent: begun or ended as asked, or why not."""

    path: Path | None  #: the run's folder
    problem: str


class Trouble(NamedTuple):
    """Recorder -> parent, unasked: the recording has ended by itself."""

    text: str


class Recorder:
    """The parent's side. One thread may use it at a time."""

    def __init__(self, ring: Ring, robot: RobotFile, runs: Path, clock: StationClock = REAL_TIME) -> None:
        """Start the process.

        Args:
            ring: telemetry to record, owned by the caller.
            robot: whose telemetry it is.
            runs: folder of runs.
            clock: of the station that it belongs to.
        """
        self._ring, self._clock = ring, clock
        self._trouble = ""
        self.child = Child(run_recorder, ring.name, robot, runs, clock, name="recorder")
        self._begun = False

    def begin(self, name: str, metadata: Mapping[str, Any], counted_from: float = 0.0) -> Path:
        """Record from the next row on, to the end of its motion, as a run called `name`; where its folder will be.

        The tip's errors count from `counted_from` [s] after the motion's start on.

        Raises:
            RecordingError: the folder cannot be made, or the recorder is gone.
        """
        self._trouble = ""
        begin = Begin(name, metadata, self._ring.written, counted_from)
        path = self._ask(begin, ANSWER_TIME if self._begun else START_TIME)
        self._begun = True
        return path

    def event(self, event: Event) -> None:
        """Note something that happened; without a recording it is forgotten."""
        self.child.tell(event)  # `trouble` says when the recorder is gone

    def end(self, label: Label, cause: str = "", numbers: Mapping[str, Any] | None = None) -> Path:
        """Finish the recording, with the rows so far where its motion has not ended; the run's folder.

        Raises:
            RecordingError: it could not be finished, had ended before, or the recorder is gone.
        """
        return self._ask(End(label, cause, numbers or {}), ANSWER_TIME)

    def trouble(self) -> str:
        """Why the recording has ended by itself; empty while all is well. Never waits."""
        try:
            while self.child.pipe.poll():
                self._note(self.child.pipe.recv())
        except (EOFError, OSError):
            self._trouble = self._trouble or self._gone()
        return self._trouble

    def close(self) -> None:
        """End the process; a recording that is on is finished as interrupted."""
        self.child.close(self._clock.real(ANSWER_TIME))

    def _ask(self, question: Begin | End, patience: float) -> Path:
        deadline = self._clock.now() + patience
        try:
            self.child.pipe.send(question)
            while self.child.pipe.poll(self._clock.real(max(0.0, deadline - self._clock.now()))):
                message = self.child.pipe.recv()
                if isinstance(message, Answer):
                    if message.path is None:
                        raise RecordingError(message.problem)
                    return message.path
                self._note(message)
        except (EOFError, OSError):
            raise RecordingError(self._gone()) from None
        # A late answer would be taken for the answer to the next question.
        self.child.kill()
        raise RecordingError(
            f"the recorder did not answer within {patience:g} s and was ended (a slow disk?); reset starts another one"
        )

    def _note(self, message: Answer | Trouble) -> None:
        if isinstance(message, Trouble):
            self._trouble = message.text

    def _gone(self) -> str:
        how = self.child.ended(self._clock.real(1.0))
        return f"the recorder ended {how}; reset starts another one, and recovers what it had written"


def run_recorder(
    ring_name: str, robot: RobotFile, runs: Path, clock: StationClock, pipe: Connection, parent: int
) -> None:
    """Main function of the recorder's process."""
    show_as("ctr-recorder")
    # Ctrl-C in a terminal reaches the whole group: the parent decides when we end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    channels = Channels(robot.robot())
    ring = Ring(len(channels), ring_name)
    _warm_up(robot, channels)
    recording: _Recording | None = None
    # `Connection.poll` makes a selector for every call: a tenth of all the work there is.
    asks = select.poll()
    asks.register(pipe.fileno(), select.POLLIN)
    due = clock.now() + FLUSH
    try:
        while not asked and os.getppid() == parent:
            ring.numbers[RECORDER_HEARTBEAT] = clock.now()
            if asks.poll(max(0.0, 1e3 * clock.real(due - clock.now()))):
                message: Begin | End | Event | None = pipe.recv()
                if message is None:
                    break
                if isinstance(message, Begin):
                    recording, answer = _begin(message, recording, robot, channels, runs, ring)
                    ring.numbers[RECORDER_HEARTBEAT] = clock.now()  # from here on somebody looks
                    pipe.send(answer)
                elif isinstance(message, End):
                    answer = recording.end(message) if recording else Answer(None, "nothing is being recorded")
                    recording = None
                    ring.numbers[RECORDER_HEARTBEAT] = clock.now()  # it may have taken a while
                    pipe.send(answer)
                elif recording is not None:
                    recording.writer.event(message)
                continue
            # A machine that was asleep does not make up for what it missed.
            due = max(due + FLUSH, clock.now())
            if recording is not None:
                try:
                    recording.copy()
                except RecordingError as error:
                    recording.give_up(str(error))
                    recording = None
                    pipe.send(Trouble(str(error)))
    except (EOFError, OSError):
        pass  # the parent is gone; what it had begun is finished below
    finally:
        if recording is not None:
            recording.end(End(Label.INTERRUPTED, "the station process is gone", {}))
        ring.close(remove=os.getppid() != parent)


def _warm_up(robot: RobotFile, channels: Channels) -> None:
    """Load the model's compiled code now: at the first rows it would hold them back for longer than a kill may cost."""
    row = np.zeros(len(channels))
    channels.of(row, "joints")[:] = [0.5 * (joint.lower + joint.upper) for joint in robot.joints]
    Drawing(robot.robot(), channels.all, 1).messages(row, 0)


class _Recording:
    """The recording that is on."""

    def __init__(self, folder: RunFolder, writer: CaseWriter, begin: Begin, ring: Ring, channels: Channels) -> None:
        self.writer = writer
        self._of_run = RunRows(channels)
        self._folder, self._ring, self._begin = folder, ring, begin
        self._next = begin.since
        self._cpu = time.process_time()
        self._missed = 0
        self._last = 0.0

    def copy(self) -> None:
        """Rows of the run since the last time, to disk."""
        rows, self._next, missed = self._ring.read(self._next)
        if missed and not self._of_run.over:
            self._missed += missed
            text = f"{missed} rows were overwritten before the recorder came to read them"
            self.writer.event(Event(self._last, "recorder", text, WARNING, {"missed": missed}))
        rows = self._of_run.take(rows)
        if len(rows):
            self._last = float(rows[-1, 0])
        self.writer.write(rows)

    def end(self, end: End) -> Answer:
        """Finish as asked."""
        try:
            self.copy()
            self.writer.close(end.label, end.cause, missed=self._missed, cpu_s=time.process_time() - self._cpu)
            numbers = {**end.numbers, **self._errors()}
            self._folder.finish(self._summary(end.label, end.cause, numbers))
        except RecordingError as error:
            self.give_up(str(error))
            return Answer(None, str(error))
        return Answer(self._folder.path, "")

    def give_up(self, problem: str) -> None:
        """The disk takes no more: what is there is kept, by the next recovery if not now."""
        with contextlib.suppress(RecordingError):
            self._folder.finish(self._summary(Label.INCOMPLETE, problem, {}))

    def _errors(self) -> Mapping[str, Any]:
        """Of the tip, if its motion has begun and settled, and had a path to keep to."""
        start, first = self._of_run.motion_start, self._begin.counted_from
        if start is None:
            return {}
        if self._begin.metadata.get("settings", {}).get("trajectory", {}).get("kind") == SWEEP:
            return {"motion_start": start, "counted_from_s": first}
        recording = read_case(self._folder.case(CASE), MOST_ROWS)
        found = motion_errors(recording.of, start, first)
        return {"motion_start": start, "counted_from_s": first, **found}

    def _summary(self, label: Label, cause: str, numbers: Mapping[str, Any]) -> dict[str, Any]:
        told = {
            key: self._begin.metadata[key]
            for key in ("experiment", "title", "seed", "clock_rate")
            if key in self._begin.metadata
        }
        done = label is Label.COMPLETE
        return {
            **told, "started": self.writer.started, "label": label, "cause": cause, "completed": done,
            "cases": {CASE: {"completed": done, "cause": cause, **numbers}},
        }  # fmt: skip


def _begin(
    begin: Begin, before: _Recording | None, robot: RobotFile, channels: Channels, runs: Path, ring: Ring
) -> tuple[_Recording | None, Answer]:
    if before is not None:
        return before, Answer(None, "a recording is on already")
    try:
        folder = RunFolder(runs, begin.name)
    except RecordingError as error:
        return None, Answer(None, str(error))
    try:
        about = {**begin.metadata, "run": folder.path.name, "robot": robot.model_dump(mode="json")}
        writer = CaseWriter(folder.case(CASE), robot.robot(), channels.all, about)
    except RecordingError as error:
        folder.let_go()
        recover(runs)
        return None, Answer(None, str(error))
    return _Recording(folder, writer, begin, ring, channels), Answer(folder.path, "")
