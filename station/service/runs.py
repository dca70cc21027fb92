"""Numbered runs of a station, of which one at a time is active; runs are recorded if the station has a folder."""

import itertools
import math
import threading
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from station.control.messages import StateNotice
from station.control.ring import Ring
from station.control.states import State
from station.service.live_recording import LiveRecording
from station.service.rig import Rig
from station.service.run_request import RunRequest, StartRequest


class Runs:
    """Register of runs and owner of their recording; its methods are thread-safe."""

    def __init__(self, bench: Rig, ring: Ring, folder: Path | None) -> None:
        """Prepare runs that are recorded in `folder`, if given; `open` starts the recorder."""
        self._bench, self._ring, self._folder = bench, ring, folder
        self.session = f"{datetime.now().astimezone():%Y%m%d-%H%M%S}"
        self._numbers = itertools.count(1)
        self._lock, self._renewing = threading.Lock(), threading.Lock()
        self._prepared: RunRequest | None = None
        self._current: RunRequest | None = None
        self._recorded: RunRequest | None = None  # run whose recording is in progress
        self._recording: LiveRecording | None = None

    def open(self) -> None:
        """Start the recorder's process, if there is a folder."""
        if self._folder is not None:
            self._recording = LiveRecording(self._ring, self._bench.robot, self._folder, self._bench.clock)

    def renew(self) -> bool:
        """Replace a recorder that has died or hangs; return whether it was replaced."""
        with self._renewing:
            old = self._recording
            if old is None or old.healthy:
                return False
            old.kill()
            self._recorded = None
            self.open()
            old.close()
            return True

    @property
    def pid(self) -> int | None:
        """Process ID of the recorder."""
        return None if self._recording is None else self._recording.pid

    @property
    def recovered(self) -> list[Path]:
        """Folders of runs that an earlier station left unfinished and whose recordings this station has finished."""
        return [] if self._recording is None else self._recording.recovered

    @property
    def not_recoverable(self) -> list[str]:
        """Sentences about unfinished runs that only a newer ctr-station can finish."""
        return [] if self._recording is None else self._recording.not_recoverable

    @property
    def current(self) -> RunRequest | None:
        """Present run or last run; None before the first run."""
        return self._current

    @property
    def recording(self) -> bool:
        """Whether a run is being recorded, or its recording is being finished."""
        return self._recorded is not None or (self._recording is not None and self._recording.finishing)

    def prepare(self, start: StartRequest, until: float = math.inf) -> RunRequest:
        """Number a start request and start its recording; the caller must then call `accepted` or `refused`.

        Raises:
            RecordingError: the recording cannot start by `until` on the station's clock [s].
        """
        number = next(self._numbers)
        run = RunRequest(number, f"{self.session}-{number}", start)
        if self._recording is not None and start.recorded:
            known = {
                "title": start.title, "seed": self._bench.seed, "clock_rate": self._bench.clock.rate,
                "lab": self._bench.lab.model_dump(mode="json") if self._bench.devices is None
                else {"title": self._bench.title},
            }  # fmt: skip
            # The recorder chooses the name: another station with the same folder may use the run's name already.
            about = {**known, **start.about}
            name = self._recording.begin(run.id, start.task.duration, start.counted_from, about, until)
            self._recorded = run = replace(run, id=name)
        with self._lock:
            self._prepared = run  # the run's first state notice may arrive before the answer to its start
        return run

    def accepted(self, run: RunRequest) -> None:
        """Set the present run after the control process has accepted it."""
        with self._lock:
            self._current = run

    def refused(self, run: RunRequest) -> None:
        """Forget a run that the control process has refused."""
        with self._lock:
            self._prepared = None
        if self._recorded is run:
            self._finish(State.STOPPED, "the control process refused the run")

    def forget(self) -> None:
        """Forget the runs of a control process that has ended."""
        with self._lock:
            self._prepared = self._current = None

    def find(self, number: int) -> StartRequest | None:
        """Return the start request of the newest or present run if this run has the number; otherwise None."""
        with self._lock:
            return next((run.start for run in (self._prepared, self._current) if run and run.number == number), None)

    def state_changed(self, notice: StateNotice) -> None:
        """Add a change of the station's state to the recording of the run."""
        if self._recording is not None:
            text = f"{notice.state.name}{notice.cause and ': '}{notice.cause}"
            self._recording.add_event(self._time(), "state", text, bad=notice.state in (State.HOLD, State.FAULT))

    def on_state(self, notice: StateNotice) -> None:
        """End the recording if the notice reports the end of its run."""
        if self._recorded is not None and notice.run == self._recorded.number and notice.state is not State.RUNNING:
            self._finish(notice.state, notice.cause)

    def interrupted(self, cause: str) -> None:
        """End the recording of a run whose control process has died."""
        if self._recording is not None and self._recorded is not None:
            self._recorded = None
            self._recording.interrupted(cause)

    def problem(self) -> str:
        """Return why the recording of the present run has failed, only at the first call; empty without a problem.

        Without a present recording, return why the last recording could not be finished.
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
        """End the recorder; it finishes the present recording and labels it *interrupted*."""
        with self._renewing:
            recording, self._recording = self._recording, None
        if recording is not None:
            recording.close()

    def _finish(self, state: State, cause: str) -> None:
        if self._recording is not None:
            self._recording.end(state, cause)
        self._recorded = None

    def _time(self) -> float:
        """Return the time of the newest telemetry [s]."""
        row = self._ring.latest()
        return 0.0 if row is None else float(row[0])
