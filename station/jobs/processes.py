"""Worker processes of this computer."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import Any, Self, TypeVar, cast

from station.threads import one_thread_during

T = TypeVar("T")
R = TypeVar("R")


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Processes:
    """Pool of worker processes (`run_jobs.Workers`); leaving its `with` block ends all of them."""

    def __init__(self, count: int) -> None:
        """Create the pool for at most `count` processes; a process starts only when there is a job for it."""
        self.at_a_time = count + 1  # a free worker gets its next job while this process stores a result
        self._count, self._context = count, get_context("spawn")
        self._others = set(active_children())
        # Fraction done of the job in each slot. The array has no lock, because a killed process would keep it.
        self._fractions = self._context.Array("d", self.at_a_time, lock=False)
        self._futures: list[Future[Any] | None] = [None] * self.at_a_time
        self._pool = self._new_pool()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for child in self._children():
                child.kill()
        self._pool.shutdown(cancel_futures=True)

    def prepare(self, work: Callable[[], None]) -> None:
        """Carry out `work` in a worker process in the background, before the first job needs it."""
        self._start(work)

    def submit(self, work: Callable[[T, Callable[[float], None]], R], job: T) -> Future[R]:
        """Start a job, or queue it until a process is free."""
        slot = next(slot for slot, future in enumerate(self._futures) if future is None or future.done())
        self._fractions[slot] = 0.0
        self._futures[slot] = future = self._start(_carry_out, work, job, slot)
        return future

    def fractions(self) -> Mapping[Future[Any], float]:
        """Return the fraction done of each job that is not done."""
        parts: list[float] = list(cast(Any, self._fractions))
        pairs = zip(self._futures, parts, strict=True)
        return {future: part for future, part in pairs if future is not None and not future.done()}

    def interrupt(self) -> None:
        """Send Ctrl-C to the running jobs."""
        for child in self._children():
            os.kill(child.pid, signal.SIGINT)

    def raise_unless_lost(self, error: Exception) -> None:
        """Raise the error of a job; return if the error means that the job's process has ended."""
        if not isinstance(error, BrokenProcessPool):
            raise error

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self._count, self._context, _start_worker, (self._fractions,))

    def _start(self, function: Callable[..., R], *arguments: Any) -> Future[R]:
        with one_thread_during(), _interrupts_blocked():
            try:
                return self._pool.submit(function, *arguments)
            except BrokenProcessPool:  # one of its processes has ended, so the pool has ended all others
                self._pool.shutdown()
                self._pool = self._new_pool()
                return self._pool.submit(function, *arguments)

    def _children(self) -> list[Any]:
        return [child for child in active_children() if child not in self._others]


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Delay Ctrl-C while worker processes start: they inherit the blocked signal, then ignore and unblock it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


#: In a worker process: the shared array with the fraction done of each job.
_shared_fractions: list[Any] = []


def _start_worker(fractions: Any) -> None:
    """Initialise a worker process: ignore Ctrl-C, which a run handles itself, and end when the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _shared_fractions.append(fractions)
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _carry_out(work: Callable[[T, Callable[[float], None]], R], job: T, slot: int) -> R:
    """Carry out one job in a worker process."""

    def progress(part: float) -> None:
        _shared_fractions[0][slot] = part

    return work(job, progress)
