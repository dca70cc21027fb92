"""Queue of runs: starts the next run when the previous one is complete, and pauses at the first HOLD, STOP or fault.

Every start needs the permit of the request that filled or resumed the queue. A STOP or a reset voids this permit, so
after a STOP nothing moves until an operator resumes the queue.
"""

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from core.errors import CtrError
from station.control.states import LATCHED, RefusedError, State
from station.service.permits import Permit, VoidError
from station.service.runs import RunRequest
from station.service.status import StationStatus
from station.service.supervisor import Supervisor

#: Interval between two checks of the station's state [s].
POLL_INTERVAL_S = 0.2
#: Largest number of entries, finished ones included.
MAX_ENTRIES = 200


class EntryState(StrEnum):
    """State of one entry of the queue."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class QueueEntry:
    """One run of the queue."""

    id: int
    title: str
    start: Callable[[Permit], RunRequest]  #: starts the run with a permit
    by_hand: str = ""  #: what a person must do before this run, for example attach a load; empty: nothing
    state: EntryState = EntryState.WAITING
    run: str = ""  #: id of the run; empty before its start
    reason: str = ""  #: why the run failed


@dataclass(frozen=True)
class NewRun:
    """A run to be added to the queue; see `QueueEntry`."""

    title: str
    start: Callable[[Permit], RunRequest]
    by_hand: str = ""


class RunQueue:
    """Queue of one station; its methods are thread-safe."""

    def __init__(self, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._lock = threading.RLock()
        self._entries: tuple[QueueEntry, ...] = ()
        self._ids = itertools.count(1)
        self._permit: Permit | None = None  # None: the queue is paused
        self._pause = "the queue is empty"
        self._prepared = 0  # id of the entry whose work by hand is done
        self._ended: tuple[State, str] | None = None  # state and reason at the end of the present run
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="queue", daemon=True)

    def open(self) -> None:
        """Start to work; call this once."""
        self._thread.start()

    def close(self) -> None:
        """End the queue; a run that it has started continues."""
        self._closing.set()
        self._thread.join()

    @property
    def entries(self) -> tuple[QueueEntry, ...]:
        """All entries in their order, finished ones first."""
        return self._entries

    @property
    def paused(self) -> str:
        """Why the queue starts no run now; empty while it works."""
        with self._lock:
            return self._pause if self._permit is None else ""

    def add(self, runs: Sequence[NewRun], permit: Permit) -> None:
        """Add runs at the end; an empty or finished queue starts to work.

        Raises:
            RefusedError: the queue would have more than `MAX_ENTRIES` entries.
        """
        with self._lock:
            if len(self._entries) + len(runs) > MAX_ENTRIES:
                raise RefusedError(
                    f"the queue has {len(self._entries)} entries and takes at most {MAX_ENTRIES}: clear it first"
                )
            idle = not any(entry.state in (EntryState.WAITING, EntryState.RUNNING) for entry in self._entries)
            self._entries += tuple(QueueEntry(next(self._ids), run.title, run.start, run.by_hand) for run in runs)
            if idle:
                self._permit = permit.lasting()

    def resume(self, permit: Permit) -> None:
        """Continue with the next waiting run; the work by hand before that run is done."""
        with self._lock:
            waiting = self._next()
            if waiting is None:
                raise RefusedError("no run of the queue waits: add one")
            self._permit, self._prepared = permit.lasting(), waiting.id

    @property
    def permit(self) -> Permit | None:
        """Permit with which the queue starts its runs now; None while it is paused."""
        return self._permit

    def pause(self, reason: str, permit: Permit | None = None) -> None:
        """Start no further run; the present run continues. With `permit`, keep a queue that has another permit now."""
        with self._lock:
            if self._permit is not None and (permit is None or permit is self._permit):
                self._permit, self._pause = None, reason

    def remove(self, number: int) -> None:
        """Remove an entry that is not running.

        Raises:
            RefusedError: there is no such entry, or it is running.
        """
        with self._lock:
            entry = self._entry(number)
            if _runs(entry, self._supervisor.status()):
                raise RefusedError(f"'{entry.title}' is running: press STOP to end it")
            self._entries = tuple(one for one in self._entries if one.id != number)

    def clear(self) -> None:
        """Remove every entry that is not running."""
        with self._lock:
            status = self._supervisor.status()
            self._entries = tuple(one for one in self._entries if _runs(one, status))

    def move(self, number: int, by: int) -> None:
        """Move a waiting entry towards the start (`by` < 0) or the end of the queue, within the waiting entries.

        Raises:
            RefusedError: there is no such entry, or it does not wait.
        """
        with self._lock:
            entry = self._entry(number)
            if entry.state is not EntryState.WAITING:
                raise RefusedError(f"'{entry.title}' is {entry.state}: only a waiting run can be moved")
            others = [one for one in self._entries if one.state is EntryState.WAITING and one.id != number]
            index = [one.id for one in self._entries if one.state is EntryState.WAITING].index(number)
            others.insert(max(0, min(len(others), index + by)), entry)
            self._entries = (*(one for one in self._entries if one.state is not EntryState.WAITING), *others)

    def _entry(self, number: int) -> QueueEntry:
        for entry in self._entries:
            if entry.id == number:
                return entry
        raise RefusedError(f"the queue has no entry {number}")

    def _next(self) -> QueueEntry | None:
        return next((entry for entry in self._entries if entry.state is EntryState.WAITING), None)

    def _put(self, entry: QueueEntry) -> None:
        with self._lock:
            self._entries = tuple(entry if one.id == entry.id else one for one in self._entries)

    def _work(self) -> None:
        while not self._closing.wait(POLL_INTERVAL_S):
            running = next((entry for entry in self._entries if entry.state is EntryState.RUNNING), None)
            if running is not None:
                self._watch(running)
            else:
                self._start_next()

    def _watch(self, entry: QueueEntry) -> None:
        """Note the end of the running entry; pause unless the run is complete."""
        status = self._supervisor.status()
        if _runs(entry, status):
            return
        if self._ended is None:  # a reset may come before the recording is complete
            self._ended = status.state, status.cause or status.state.name
        if status.recording:
            return
        state, reason = self._ended
        with self._lock:
            if all(one.id != entry.id for one in self._entries):
                return  # the entry has been removed, and the queue may already have a new permit
            if state is State.READY:
                self._put(replace(entry, state=EntryState.DONE))
            else:
                self._put(replace(entry, state=EntryState.FAILED, reason=reason))
                self.pause(f"'{entry.title}' ended in {state.name}: {reason}")

    def _start_next(self) -> None:
        with self._lock:
            # The state is read after the permit: an older state could pause a queue that has just been filled.
            permit, entry = self._permit, self._next()
            status = self._supervisor.status()
            if permit is None:
                return
            if entry is None:
                self.pause("all runs are done")
                return
            if status.state in LATCHED:
                self.pause(f"the station is in {status.state.name}: reset it, then resume the queue")
                return
            if status.state is not State.READY or status.recording:
                return
            if entry.by_hand and self._prepared != entry.id:
                self.pause(f"before '{entry.title}': {entry.by_hand}; then resume the queue")
                return
        self._ended = None
        try:
            run = entry.start(permit)
        except VoidError as error:  # a STOP or a reset: the run may still be started after `resume`
            self.pause(str(error), permit)
            return
        except CtrError as error:
            with self._lock:
                self._put(replace(entry, state=EntryState.FAILED, reason=str(error)))
                self.pause(f"'{entry.title}' did not start: {error}")
            return
        self._put(replace(entry, state=EntryState.RUNNING, run=run.id))


def _runs(entry: QueueEntry, status: StationStatus) -> bool:
    """Return whether the robot still moves for an entry; the entry's state follows when the recording is complete."""
    return (
        entry.state is EntryState.RUNNING
        and status.state is State.RUNNING
        and status.run is not None
        and status.run.id == entry.run
    )
