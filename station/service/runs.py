"""The runs of a station: numbered, recorded where there is a folder for it, one at a time."""

import itertools
import threading
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from station.control.messages import Notice
from station.control.ring import Ring
from station.control.states import State
from station.service.bench import Bench
from station.service.live_recording import LiveRecording
from station.service.start import Run, Start


class Runs:
    """Who is told of every start and of every change of state; any thread may ask."""

    def __init__(self, bench: Bench, ring: Ring, folder: Path | None) -> None:
        """Recordings go into `folder`, if given, once this is opened."""
        self._bench, self._ring, self._folder = bench, ring, folder
        self.session = f"{datetime.now().astimezone():%Y%m%d-%H%M%S}"
        self._numbers = itertools.count(1)
        self._lock, self._renewing = threading.Lock(), threading.Lock()
        self._asked: Run | None = None
        self._current: Run | None = None
        self._recorded: Run | None = None  # the one that is being recorded
        self._recording: LiveRecording | None = None

    def open(self) -> None:
        """Start the recorder's process, if there is a folder for it."""
        if self._folder is not None:
            self._recording = LiveRecording(self._ring, self._bench.robot, self._folder, self._bench.clock)

    def renew(self) -> bool:
        """Start another recorder in the place of one that has died or stands still; whether it was so."""
        with self._renewing:
            old = self._recording
            if old is None or old.well:
                return False
            old.kill()
            self._recorded = None
            self.open()
            old.close()
            return True

    @property
    def pid(self) -> int | None:
        """Number of the recorder's process."""
        return None if self._recording is None else self._recording.pid

    @property
    def recovered(self) -> list[Path]:
        """Folders of runs that a station before this one has left unfinished; they are finished now."""
        return [] if self._recording is None else self._recording.recovered

    @property
    def left_alone(self) -> list[str]:
        """What to do about those that only a later ctr-station can finish."""
        return [] if self._recording is None else self._recording.left_alone

    @property
    def current(self) -> Run | None:
        """The run that is on, or the last one; None before the first."""
        return self._current

    @property
    def recording(self) -> bool:
        """Whether a run is being recorded, or its recording is being finished."""
        return self._recorded is not None or (self._recording is not None and self._recording.finishing)

    def prepare(self, start: Start) -> Run:
        """Number a start and begin its recording; `accepted` or `refused` has to follow.

        Raises:
            RecordingError: it cannot be recorded.
        """
        number = next(self._numbers)
        run = Run(number, f"{self.session}-{number}", start)
        if self._recording is not None and start.recorded:
            known = {
                "title": start.title, "seed": self._bench.seed, "clock_rate": self._bench.clock.rate,
                "lab": self._bench.lab.model_dump(mode="json") if self._bench.devices is None
                else {"title": self._bench.title},
            }  # fmt: skip
            # What its folder is called: another station on the same folder may have taken that name.
            name = self._recording.begin(run.id, start.task.duration, start.counted_from, {**known, **start.about})
            self._recorded = run = replace(run, id=name)
        with self._lock:
            self._asked = run  # its first notice may come before the answer
        return run

    def accepted(self, run: Run) -> None:
        """The control process has begun to carry it out."""
        with self._lock:
            self._current = run

    def refused(self, run: Run) -> None:
        """The control process has refused it."""
        with self._lock:
            self._asked = None
        if self._recorded is run:
            self._finish(State.STOPPED, "it was refused after all")

    def forget(self) -> None:
        """The control process that knew of the last run is no more."""
        with self._lock:
            self._asked = self._current = None

    def find(self, number: int) -> Start | None:
        """What was asked for with that number, if it is the newest run."""
        with self._lock:
            return next((run.start for run in (self._asked, self._current) if run and run.number == number), None)

    def state_changed(self, notice: Notice) -> None:
        """Note it in the recording."""
        if self._recording is not None:
            text = f"{notice.state.name}{notice.cause and ': '}{notice.cause}"
            self._recording.say(self._time(), "state", text, bad=notice.state in (State.HOLD, State.FAULT))

    def heard(self, notice: Notice) -> None:
        """End the recording of a run that is no longer carried out."""
        if self._recorded is not None and notice.run == self._recorded.number and notice.state is not State.RUNNING:
            self._finish(notice.state, notice.cause)

    def interrupted(self, cause: str) -> None:
        """The process that carried out the run has died."""
        if self._recording is not None and self._recorded is not None:
            self._recorded = None
            self._recording.interrupted(cause)

    def problem(self) -> str:
        """Why the recording of the run that is on has ended by itself, told once; empty while all is well.

        The same of the last run, if it could not be finished.
        """
        if self._recording is None:
            return ""
        if self._recorded is None:
            return self._recording.lost()
        if not (problem := self._recording.problem()):
            return ""
        self._recorded = None
        return f"the recording has ended: {problem}"

    def close(self) -> None:
        """Finish what is being recorded, as interrupted."""
        with self._renewing:
            recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()

    def _finish(self, state: State, cause: str) -> None:
        if self._recording is not None:
            self._recording.end(state, cause)
        self._recorded = None

    def _time(self) -> float:
        """Time of the newest telemetry [s]."""
        row = self._ring.latest()
        return 0.0 if row is None else float(row[0])
