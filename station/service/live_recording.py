"""The recording of live runs: begun with a run, ended with it, off the threads that must not wait."""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.ring import RECORDER_HEARTBEAT, Ring
from station.control.states import State
from station.recording.events import ERROR, INFO, Event
from station.recording.label import Label, RecordingError
from station.recording.recorder import START_TIME, Recorder
from station.recording.recover import left_alone, recover
from station.recording.space import free_space_problem
from station.service.sign_of_life import goes_on

#: A recorder that has shown no sign of life for so long stands still [s]; the ring holds 8 s.
SILENT = 3.0


class LiveRecording:
    """One recorder; any thread may ask. What was left behind by a station that was killed is recovered first."""

    def __init__(self, ring: Ring, robot: RobotFile, runs: Path, clock: StationClock) -> None:
        self.runs = runs
        self.recovered = recover(runs)  #: folders of runs that were left behind
        self.left_alone = left_alone(runs)  #: sentences about those that cannot be recovered here
        self._ring, self._clock = ring, clock
        ring.numbers[RECORDER_HEARTBEAT], self._started = 0.0, clock.now()
        self._recorder = Recorder(ring, robot, runs, clock)
        # One thread: the recorder answers one question at a time.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")
        self._looking: Future[None] | None = None
        self._ending: Future[None] | None = None
        self._problem = self._lost = ""

    @property
    def pid(self) -> int:
        """Number of the recorder's process."""
        return self._recorder.child.pid

    def begin(self, name: str, duration: float, counted_from: float, metadata: Mapping[str, Any]) -> str:
        """Record from now on, for about `duration` [s], as `name`; the name it got, which no other run has.

        Errors count from `counted_from` [s] of the motion on.

        Raises:
            RecordingError: there is no room, or the recorder cannot.
        """
        problem = self._stands_still() or free_space_problem(self.runs, duration)
        if problem:
            raise RecordingError(problem)
        self._problem, self._lost = "", ""
        self._ring.clear_timing()
        return self._thread.submit(self._recorder.begin, name, metadata, counted_from).result().name

    @property
    def finishing(self) -> bool:
        """Whether the last recording has been ended but not been finished yet."""
        return self._ending is not None and not self._ending.done()

    def say(self, time: float, kind: str, text: str, *, bad: bool = False) -> None:
        """Note what happens at `time` of the telemetry [s]."""
        self._thread.submit(self._recorder.event, Event(time, kind, text, ERROR if bad else INFO))

    def end(self, state: State, cause: str) -> None:
        """The run has ended, in this state; does not wait."""
        label = Label.COMPLETE if state is State.READY else Label.STOPPED
        self._ending = self._thread.submit(self._end, label, cause, self._numbers_now())

    def interrupted(self, cause: str) -> None:
        """The process that ran it has died; does not wait."""
        self._ending = self._thread.submit(self._end, Label.INTERRUPTED, cause, self._numbers_now())

    def problem(self) -> str:
        """Why the recording that was on has ended by itself; empty while all is well. Does not wait."""
        if still := self._stands_still():
            return still
        if self._looking is None or self._looking.done():
            self._looking = self._thread.submit(self._look)
        return self._problem

    def lost(self) -> str:
        """Why the last recording could not be finished, told once; empty while all is well."""
        lost, self._lost = self._lost, ""
        return lost

    @property
    def well(self) -> bool:
        """Whether the recorder lives, and does not stand still; looks for a sign of it, for `SILENT` at most."""
        if not self._recorder.child.alive:
            return False
        starting = not self._ring.numbers[RECORDER_HEARTBEAT] and self._clock.now() - self._started < START_TIME
        return starting or self.finishing or goes_on(self._ring, RECORDER_HEARTBEAT, self._clock, SILENT)

    def close(self) -> None:
        """Finish what is on, as interrupted."""
        self._thread.submit(self._recorder.close).result()
        self._thread.shutdown()

    def kill(self) -> None:
        """End the recorder at once; what it had written can be recovered then, and `close` does not wait for it."""
        self._recorder.child.kill()
        self._recorder.child.ended()

    def _stands_still(self) -> str:
        """Why nothing can be recorded now; empty while it shows that it lives, is starting or finishing a recording."""
        beat = float(self._ring.numbers[RECORDER_HEARTBEAT])
        if not beat or self.finishing or self._clock.now() - beat <= SILENT:
            return ""
        return f"the recorder has stood still for {SILENT:g} s; reset starts another one"

    def _look(self) -> None:
        self._problem = self._problem or self._recorder.trouble()

    def _numbers_now(self) -> dict[str, Any]:
        """Of this run; taken before the next one may begin, which counts anew."""
        ring = self._ring
        counts = {"late_counts": ring.late.tolist(), "tick_counts": ring.busy.tolist()}
        return {"timing": {**ring.timing()._asdict(), **counts}}

    def _end(self, label: Label, cause: str, numbers: Mapping[str, Any]) -> None:
        try:
            self._recorder.end(label, cause, numbers)
        except RecordingError as error:
            self._problem = self._problem or str(error)
            why = self._recorder.trouble() or str(error)
            self._lost = f"the recording of the last run was not finished: {why}"
