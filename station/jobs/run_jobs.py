"""Run jobs in parallel and keep their results in a manifest: the same call continues after any interruption.

Jobs share no state. Therefore it does not matter for the results whether jobs run in this process, in local processes,
on a Dask cluster, or in parts on the computers of a job array.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

from core.errors import CtrError
from station.jobs.dask_cluster import dask_workers
from station.jobs.interrupts import JobInterrupted, interrupts
from station.jobs.processes import Processes

#: Longest time between two progress reports of the jobs [s].
PROGRESS_INTERVAL_S = 0.2
#: Reason why a job has no result.
LOST = "its worker process ended before it was done; was it killed, or is there too little memory?"

T = TypeVar("T")
R = TypeVar("R")
K = TypeVar("K")
#: Function that carries out one job: takes the job and a callback for the fraction done, returns the result.
Work = Callable[[T, Callable[[float], None]], R]


class ProcessLost(CtrError):
    """A worker process ended before its job was done."""


class Workers(Protocol):
    """Workers that carry out jobs with an executor of `concurrent.futures`."""

    #: Largest number of jobs that are submitted and not done.
    at_a_time: int

    def submit(self, work: Work[Any, R], job: Any) -> Future[R]:
        """Start a job, or queue it."""
        ...

    def fractions(self) -> Mapping[Future[Any], float]:
        """Return the fraction done of the running jobs, as far as it is known."""
        ...

    def interrupt(self) -> None:
        """Send Ctrl-C to the running jobs."""
        ...

    def raise_unless_lost(self, error: Exception) -> None:
        """Raise the error of a job, or a clearer error; return if the error means that the job's worker has ended."""
        ...


class Results(Protocol):
    """Results of the finished jobs by key: a file (`manifest.py`) or a dictionary."""

    def __contains__(self, key: object, /) -> bool: ...
    def __setitem__(self, key: Any, result: Any, /) -> None: ...


@contextmanager
def start_workers(count: int, scheduler: str | None, report: Callable[[str], None]) -> Iterator[Workers]:
    """Start `count` local processes, or connect to the Dask scheduler at an address (`local`: `count` Dask workers).

    `report` receives a line with the address of the cluster.

    Raises:
        DaskError: no scheduler answers, or the scheduler ends later.
    """
    with Processes(count) if scheduler is None else dask_workers(scheduler, count, report) as found:
        yield found


def run_jobs(
    work: Work[T, R],
    jobs: Mapping[K, T],
    workers: Workers | None,
    manifest: Results,
    report: Callable[[Mapping[K, float]], None] = lambda _: None,
    *,
    lost: Callable[[T], R] | None = None,
    proceed: Callable[[R], bool] = lambda _: True,
) -> None:
    """Carry out the jobs that the manifest does not have, in their order, and store each result immediately.

    No further job starts after Ctrl-C, which also interrupts the running jobs, or after `proceed` has returned False.
    When a worker ends, its unfinished jobs are repeated one at a time after all others, because any of them may be the
    cause.

    Args:
        work: function that carries out one job.
        jobs: jobs by key.
        workers: where the jobs run; None: in this process, one after the other.
        manifest: receives the results.
        report: receives the fraction done of the running jobs.
        lost: returns the result of a job whose worker has ended in both attempts; None: a lost job is an error.
        proceed: decides with each result whether a further job may start.

    Raises:
        ProcessLost: a worker was killed, and `lost` is None.
    """
    waiting = deque(key for key in jobs if key not in manifest)
    if workers is None:
        for key in waiting:
            result = work(jobs[key], lambda part, key=key: report({key: part}))
            manifest[key] = result
            report({})
            if not proceed(result):
                return
        return
    running, finished = dict[Future[R], K](), SimpleQueue[Future[R]]()
    suspected, alone = list[K](), set[K]()

    def start(key: K) -> None:
        future = workers.submit(work, jobs[key])
        running[future] = key
        future.add_done_callback(finished.put)

    def store(future: Future[R]) -> bool:
        key = running.pop(future)
        try:
            result = future.result()
        except JobInterrupted:
            return True
        except Exception as error:
            workers.raise_unless_lost(error)
            if lost is None:
                raise ProcessLost(f"a job has no result: {LOST}") from None
            if key not in alone:
                suspected.append(key)
                return True
            result = lost(jobs[key])
        manifest[key] = result
        return proceed(result)

    with interrupts() as interrupted:
        while waiting or running or suspected:
            while waiting and len(running) < workers.at_a_time:
                start(waiting.popleft())
            if not running:
                alone.add(suspected[-1])
                start(suspected.pop())
            going_on = True
            with suppress(Empty):
                future = finished.get(timeout=PROGRESS_INTERVAL_S)
                going_on = future not in running or store(future)  # a cancelled job is not in `running`
            report({running[future]: part for future, part in workers.fractions().items() if future in running})
            if interrupted() or not going_on:
                waiting.clear()
                suspected.clear()
                for future in [future for future in running if future.cancel()]:
                    del running[future]
            if interrupted():
                # A running job polls for this signal and ends. A process without a job ignores the signal and may
                # still start a queued job. So the signal is sent again until no job is left.
                workers.interrupt()
