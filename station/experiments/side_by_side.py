"""Jobs side by side, each in a process of its own, as many at a time as there are processors.

What comes out is what comes out of one after the other: a job shares nothing with its neighbours.
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
from station.experiments.interrupt import interrupts
from station.threads import one_thread_meanwhile

#: Between two looks at how far the jobs have come [s].
LOOK = 0.2

T = TypeVar("T")
R = TypeVar("R")
#: A job's work: given what it is about and whom to tell which part of it is done.
Work = Callable[[T, Callable[[float], None]], R]
#: Told which part of each job is done, in the order of the jobs.
Told = Callable[[Sequence[float]], None]


class ProcessLost(CtrError):
    """A process that ended in the middle of its job."""

    def __init__(self, text: str, jobs: frozenset[int]) -> None:
        super().__init__(text)
        self.jobs = jobs  #: numbers of those that were on: one of them, or its process, is to blame


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def one_after_the_other(work: Work[T, R], listed: Sequence[T], told: Told, go_on: Callable[[R], bool]) -> list[R]:
    """Carry out the jobs here, until all are done or `go_on` refuses after one."""
    parts, results = [0.0] * len(listed), list[R]()
    for number, about in enumerate(listed):

        def progress(part: float, number: int = number) -> None:
            parts[number] = part
            told(parts)

        results.append(work(about, progress))
        if not go_on(results[-1]):
            break
        progress(1.0)
    return results


class Processes:
    """The processes; a context that leaves none behind."""

    def __init__(self, most: int) -> None:
        """At most so many, each started when there is something for it to do."""
        context = get_context("spawn")
        self._others = set(active_children())
        # A place for each process: the number of its job, and which part of it is done.
        self._places = context.Array("d", 2 * most, lock=False)  # one that is killed must leave no lock
        number = context.Value("i", 0)
        self._pool = ProcessPoolExecutor(most, context, _begin, (self._places, number))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for child in self._children():
                child.kill()
        self._pool.shutdown(cancel_futures=True)

    def prepare(self, work: Callable[[], None]) -> None:
        """Have a first process do this meanwhile."""
        with one_thread_meanwhile(), _deaf_to_interrupts():
            self._pool.submit(work)

    def carry_out(
        self, work: Work[T, R], listed: Sequence[T], told: Told, go_on: Callable[[R], bool] = lambda _: True
    ) -> list[R]:
        """Results of the jobs that were carried out, in their order.

        After Ctrl-C, or once `go_on` refuses a result, jobs that have not begun are left out; Ctrl-C also asks
        those that are on to end.

        Raises:
            ProcessLost: a process was killed.
        """
        try:
            with one_thread_meanwhile(), _deaf_to_interrupts():
                futures = [self._pool.submit(_work, work, number, about) for number, about in enumerate(listed)]
            self._wait(futures, told, go_on)
            return [future.result() for future in futures if not future.cancelled()]
        except BrokenProcessPool:
            places: list[float] = list(cast(Any, self._places))
            raise ProcessLost(
                "a process ended in the middle of its job; was it killed, is there too little memory?",
                frozenset(map(int, places[::2])),
            ) from None

    def _wait(self, futures: Sequence[Future[R]], told: Told, go_on: Callable[[R], bool]) -> None:
        with interrupts() as interrupted:
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=LOOK, return_when=FIRST_COMPLETED)
                told(self._parts(futures))
                if interrupted():
                    for child in self._children():
                        # A run takes it as a question and ends; between runs it is ignored, and a run that was
                        # next in the line may begin yet: asked again until none is left.
                        if child.pid is not None:
                            os.kill(child.pid, signal.SIGINT)
                going_on = [go_on(future.result()) for future in done if not future.cancelled()]
                if interrupted() or not all(going_on):
                    waiting = {future for future in waiting if not future.cancel()}

    def _parts(self, futures: Sequence[Future[Any]]) -> list[float]:
        places: list[float] = list(cast(Any, self._places))
        running = dict(zip(map(int, places[::2]), places[1::2], strict=True))
        return [
            1.0 if future.done() and not future.cancelled() else running.get(number, 0.0)
            for number, future in enumerate(futures)
        ]

    def _children(self) -> list[Any]:
        return [child for child in active_children() if child not in self._others]


#: Of the process that this is: where it tells how far its job has come.
_place: list[tuple[Any, int]] = []


def _begin(places: Any, number: Any) -> None:
    """In each new process: take a place, and watch whether the one that started it is still there."""
    with number:
        _place.append((places, 2 * number.value))
        number.value += 1
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _work(work: Work[T, R], number: int, about: T) -> R:
    """In a process: one job."""
    places, at = _place[0]

    def progress(part: float) -> None:
        places[at] = number
        places[at + 1] = part

    progress(0.0)
    return work(about, progress)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """New processes ignore Ctrl-C from their first moment on; only a run listens to it."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals go to the main thread
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
