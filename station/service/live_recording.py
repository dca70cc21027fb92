"""Recording of live runs: a separate thread controls the recorder's process, so that no other thread waits."""

import math
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.ring import RECORDER_HEARTBEAT, Ring
from station.control.states import State
from station.recording.events import ERROR, INFO, RecordedEvent
from station.recording.recorder import START_TIMEOUT_S, Recorder
from station.recording.recover import recover, unrecoverable
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.space import free_space_problem
from station.service.heartbeat import is_alive

#: Time without a heartbeat after which the recorder counts as hung [s]; shorter than the 8 s of rows in the ring.
RECORDER_TIMEOUT_S = 3.0


class LiveRecording:
    """Owner of one recorder; its methods are thread-safe. Interrupted runs of a killed station are recovered first."""

    def __init__(self, ring: Ring, robot: RobotFile, runs: Path, clock: StationClock) -> None:
        self.runs = runs
        self.recovered = recover(runs)  #: folders of recovered runs
        self.not_recoverable = unrecoverable(runs)  #: sentences about runs that this version cannot recover
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
        problem = self._stall() or free_space_problem(self.runs, duration)
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
        if not self._recorder.child.alive:
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
        return f"the recorder has not responded for {RECORDER_TIMEOUT_S:g} s; a reset starts another one"

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
