"""Queue of runs: starts the next run when the previous one is complete, and pauses at the first HOLD, STOP or fault.

Every start needs the permit of the request that filled or resumed the queue. A STOP, a reset or another operator voids
this permit, so nothing moves until an operator resumes the queue.

The check of a motion takes up to a second, or longer, and the queue may change meanwhile. Therefore the start claims
its entry at the moment in which its command is sent: the entry must be the first waiting one, and the queue must have
the same permit as before the check. From then on the entry is running.
"""

import itertools
import threading
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

from core.errors import CtrError
from station.control.states import LATCHED, RefusedError, State
from station.service.commands import StationCommand
from station.service.permits import Permit, VoidError
from station.service.runs import RunRequest
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

    title: str
    command: StationCommand  #: command that starts the run
    by_hand: str = ""  #: what a person must do before this run, for example attach a load; empty: nothing
    id: int = 0  #: number of the entry, which `RunQueue.add` gives
    state: EntryState = EntryState.WAITING
    run: str = ""  #: id of the run; empty before its start
    reason: str = ""  #: why the run failed


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
        self._sent = 0  # id of the entry whose start was sent and is not yet answered; 0: none
        self._run: RunRequest | None = None  # run of the newest entry that has started
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
        with self._lock:
            self._update()
            return self._entries

    @property
    def paused(self) -> str:
        """Why the queue starts no run now; empty while it works."""
        with self._lock:
            self._update()
            return self._pause if self._permit is None else ""

    def add(self, runs: Sequence[QueueEntry], permit: Permit) -> None:
        """Add runs at the end; an empty or finished queue starts to work.

        Raises:
            RefusedError: the queue would have more than `MAX_ENTRIES` entries.
        """
        with self._lock:
            self._update()
            if len(self._entries) + len(runs) > MAX_ENTRIES:
                raise RefusedError(
                    f"the queue has {len(self._entries)} entries and takes at most {MAX_ENTRIES}: clear it first"
                )
            idle = not any(entry.state in (EntryState.WAITING, EntryState.RUNNING) for entry in self._entries)
            self._entries += tuple(replace(run, id=next(self._ids)) for run in runs)
            if idle:
                self._permit = permit.without_deadline()

    def resume(self, permit: Permit) -> None:
        """Continue with the next waiting run; the work by hand before that run is done."""
        with self._lock:
            self._update()
            waiting = self._next()
            if waiting is None:
                raise RefusedError("no run of the queue is waiting: add one")
            self._permit, self._prepared = permit.without_deadline(), waiting.id

    def pause(self, reason: str) -> None:
        """Start no further run; the present run continues."""
        with self._lock:
            self._update()
            self._set_paused(reason)

    def remove(self, number: int) -> None:
        """Remove an entry that is not running.

        Raises:
            RefusedError: there is no such entry, or it is running.
        """
        with self._lock:
            entry = self._entry(number)
            if self._moves(entry):
                raise RefusedError(f"'{entry.title}' is running: press STOP to end it")
            self._entries = tuple(one for one in self._entries if one.id != number)

    def clear(self) -> None:
        """Remove every entry that is not running."""
        with self._lock:
            self._entries = tuple(one for one in self._entries if self._moves(one))

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

    def _set_paused(self, reason: str) -> None:
        if self._permit is not None:
            self._permit, self._pause = None, reason

    def _moves(self, entry: QueueEntry) -> bool:
        """Return whether the robot moves, or will move at once, for an entry; its recording may end later."""
        if entry.id == self._sent:
            return True
        if entry.state is not EntryState.RUNNING or self._run is None or self._run.end.done():
            return False
        status = self._supervisor.status()  # the state is known shortly before the report of the run's end
        return status.state is State.RUNNING and status.run is not None and status.run.id == entry.run

    def _update(self) -> None:
        """Note the end of the running entry, and pause if its run is incomplete or the queue's permit is void."""
        running = next((entry for entry in self._entries if entry.state is EntryState.RUNNING), None)
        if running is not None and running.id != self._sent and self._run is not None and self._run.end.done():
            state, cause = self._run.end.result()
            if state is not State.READY:
                self._put(replace(running, state=EntryState.FAILED, reason=cause or state.name))
                self._set_paused(f"'{running.title}' ended in {state.name}: {cause or state.name}")
            elif not self._supervisor.status().recording:
                self._put(replace(running, state=EntryState.DONE))
        if self._permit is not None and (problem := self._permit.problem("start")):
            self._set_paused(f"{problem}; resume the queue to continue")

    def _work(self) -> None:
        while not self._closing.wait(POLL_INTERVAL_S):
            self.step()

    def step(self) -> None:
        """Start the next run if the station and the queue allow it; the queue's thread calls this."""
        with self._lock:
            self._update()
            permit, entry = self._permit, self._startable()
        if permit is None or entry is None:
            return
        condition, claim = partial(self._refusal, permit, entry), partial(self._claim, permit, entry)
        self._run = None
        try:
            run = self._supervisor.send(entry.command, replace(permit.on(condition), claim=claim)).started
        except VoidError:  # the run may still be started, unless its entry has been removed
            with self._lock:
                self._sent = 0
                self._put(entry)
        except Exception as error:  # a defect must not end the queue's thread silently
            reason = str(error)
            if not isinstance(error, CtrError):
                traceback.print_exc()
                reason = f"internal error {error!r}"
            with self._lock:
                self._sent = 0
                if any(one.id == entry.id for one in self._entries):
                    self._put(replace(entry, state=EntryState.FAILED, reason=reason))
                    self._set_paused(f"'{entry.title}' did not start: {reason}")
        else:
            with self._lock:
                self._sent, self._run = 0, run
                self._put(replace(entry, state=EntryState.RUNNING, run=run.id))

    def _startable(self) -> QueueEntry | None:
        """Return the entry to start now; None while the station does not allow it, or after pausing the queue."""
        # The state is read after the permit: an older state could pause a queue that has just been filled.
        entry, status = self._next(), self._supervisor.status()
        if self._permit is None or any(one.state is EntryState.RUNNING for one in self._entries):
            return None
        if entry is None:
            self._set_paused("all runs are done")
        elif status.state in LATCHED:
            self._set_paused(f"the station is in {status.state.name}: reset it, then resume the queue")
        elif status.state is State.READY and not status.recording:
            if not entry.by_hand or self._prepared == entry.id:
                return entry
            self._set_paused(f"before '{entry.title}': {entry.by_hand}; then resume the queue")
        return None

    def _refusal(self, permit: Permit, entry: QueueEntry) -> str:
        """Return why the start of an entry with a permit of the queue must not be sent now; empty: it may be sent."""
        with self._lock:
            if self._sent == entry.id:
                return ""
            if self._closing.is_set():
                return "the station is ending"
            if permit is not self._permit:
                return "the queue was paused or resumed meanwhile"
            if (first := self._next()) is None or first.id != entry.id:
                return f"'{entry.title}' is not the first waiting run of the queue any longer"
            return permit.problem("start")

    def _claim(self, permit: Permit, entry: QueueEntry) -> str:
        """Return the result of `_refusal`; if it is empty, mark the entry as running, so that no request changes it."""
        with self._lock:
            if not (reason := self._refusal(permit, entry)):
                self._sent = entry.id
                self._put(replace(entry, state=EntryState.RUNNING))
            return reason
