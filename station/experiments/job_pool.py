"""Jobs in parallel, each in a separate process, at most one for each processor.

Jobs share no state, so the results are the same as those of a serial run.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from typing import Any, Self, TypeVar, cast

from core.errors import CtrError
from station.threads import one_thread_during


@contextmanager
def interrupts() -> Iterator[Callable[[], bool]]:
    """Return a function that reports whether Ctrl-C was pressed; a second press raises KeyboardInterrupt.

    A KeyboardInterrupt may occur at any instruction, and inside compiled code it becomes a SystemError. A loop that
    polls this function ends at a safe point instead.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # Python delivers signals to the main thread only
        return
    pressed = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def note(_number: int, _frame: object) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)


#: Time between two progress reports of the jobs [s].
PROGRESS_INTERVAL_S = 0.2

T = TypeVar("T")
R = TypeVar("R")
#: Function that carries out one job: takes the job and a callback for the fraction done, returns the result.
Work = Callable[[T, Callable[[float], None]], R]
#: Callback that receives a list with the fraction done of each job, in the order of the jobs.
ProgressCallback = Callable[[Sequence[float]], None]


class ProcessLost(CtrError):
    """A worker process ended before its job was done."""

    def __init__(self, text: str, jobs: frozenset[int]) -> None:
        super().__init__(text)
        self.jobs = jobs  #: numbers of the jobs that were running when the process ended; one of them is the cause


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_serially(
    work: Work[T, R], jobs: Sequence[T], report: ProgressCallback, should_continue: Callable[[R], bool]
) -> list[R]:
    """Carry out the jobs in this process until all are done or `should_continue` returns False for a result."""
    parts, results = [0.0] * len(jobs), list[R]()
    for number, job in enumerate(jobs):

        def progress(part: float, number: int = number) -> None:
            parts[number] = part
            report(parts)

        results.append(work(job, progress))
        if not should_continue(results[-1]):
            break
        progress(1.0)
    return results


class JobPool:
    """Pool of worker processes that carry out jobs; leaving its `with` block ends all processes."""

    def __init__(self, max_processes: int) -> None:
        """Create the pool; a worker process starts only when there is a job for it."""
        context = get_context("spawn")
        self._others = set(active_children())
        # The shared array has two numbers for each process: the number of its job, and the fraction of the job done.
        self._slots = context.Array("d", 2 * max_processes, lock=False)  # no lock: a killed process would keep it
        number = context.Value("i", 0)
        self._pool = ProcessPoolExecutor(max_processes, context, _start_worker, (self._slots, number))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for child in self._children():
                child.kill()
        self._pool.shutdown(cancel_futures=True)

    def prepare(self, work: Callable[[], None]) -> None:
        """Carry out `work` in a worker process in the background, before the first job needs it."""
        with one_thread_during(), _ignore_interrupts():
            self._pool.submit(work)

    def carry_out(
        self,
        work: Work[T, R],
        jobs: Sequence[T],
        report: ProgressCallback,
        should_continue: Callable[[R], bool] = lambda _: True,
    ) -> list[R]:
        """Return the results of the jobs that were carried out, in the order of the jobs.

        No further job starts after Ctrl-C, or after `should_continue` has returned False for a result. Ctrl-C also
        interrupts the jobs that are running.

        Raises:
            ProcessLost: a worker process was killed before its job was done.
        """
        try:
            with one_thread_during(), _ignore_interrupts():
                futures = [self._pool.submit(_work, work, number, job) for number, job in enumerate(jobs)]
            self._wait(futures, report, should_continue)
            return [future.result() for future in futures if not future.cancelled()]
        except BrokenProcessPool:
            slots: list[float] = list(cast(Any, self._slots))
            raise ProcessLost(
                "a worker process ended before its job was done; was it killed, or is there too little memory?",
                frozenset(map(int, slots[::2])),
            ) from None

    def _wait(
        self, futures: Sequence[Future[R]], report: ProgressCallback, should_continue: Callable[[R], bool]
    ) -> None:
        with interrupts() as interrupted:
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=PROGRESS_INTERVAL_S, return_when=FIRST_COMPLETED)
                report(self._parts(futures))
                if interrupted():
                    for child in self._children():
                        # A running job polls for this signal and ends. Between two jobs a process ignores the signal,
                        # and a queued job may still start. So the signal is sent again until no job is left.
                        if child.pid is not None:
                            os.kill(child.pid, signal.SIGINT)
                going_on = [should_continue(future.result()) for future in done if not future.cancelled()]
                if interrupted() or not all(going_on):
                    waiting = {future for future in waiting if not future.cancel()}

    def _parts(self, futures: Sequence[Future[Any]]) -> list[float]:
        slots: list[float] = list(cast(Any, self._slots))
        running = dict(zip(map(int, slots[::2]), slots[1::2], strict=True))
        return [
            1.0 if future.done() and not future.cancelled() else running.get(number, 0.0)
            for number, future in enumerate(futures)
        ]

    def _children(self) -> list[Any]:
        return [child for child in active_children() if child not in self._others]


#: In a worker process: the shared array, and the index in it at which this process reports the progress of its job.
_own_slot: list[tuple[Any, int]] = []


def _start_worker(slots: Any, number: Any) -> None:
    """Initialise a worker process: reserve a slot of the shared array, and watch the parent process.

    The worker process ends when its parent process has ended.
    """
    with number:
        _own_slot.append((slots, 2 * number.value))
        number.value += 1
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _work(work: Work[T, R], number: int, job: T) -> R:
    """Carry out one job in a worker process."""
    slots, at = _own_slot[0]

    def progress(part: float) -> None:
        slots[at] = number
        slots[at + 1] = part

    progress(0.0)
    return work(job, progress)


@contextmanager
def _ignore_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C while worker processes start, and so also in them; a run in a worker handles Ctrl-C itself."""
    if threading.current_thread() is not threading.main_thread():
        yield  # in another thread nothing changes: only the main thread may change signal handlers
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
