"""Jobs on a Dask cluster: a remote one, or one of local worker processes. Needs the extra `dask`.

The scheduler moves the jobs of a lost worker to other workers. The client stores each result on its disk, so results
survive the loss of the whole cluster.
"""

import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar
from uuid import uuid4

from core.errors import CtrError
from station.experiments.job_pool import PROGRESS_INTERVAL_S, interrupts
from station.experiments.manifest import Row
from station.experiments.sweep import failed, run_job
from station.experiments.sweep_plan import SweepJob

if TYPE_CHECKING:
    from distributed import Client, Future

#: Value of `--scheduler` that starts local worker processes instead of connecting to an address.
LOCAL = "local"
#: Largest number of jobs that the scheduler has at a time: enough for any cluster, and small enough for its memory.
MAX_QUEUED_JOBS = 1000
#: Longest time to wait until a scheduler answers a new connection [s].
SCHEDULER_TIMEOUT_S = 10.0

T = TypeVar("T")
R = TypeVar("R")


class DaskError(CtrError):
    """Dask is not installed, no scheduler answers, or the workers cannot carry out jobs."""


def check_dask() -> None:
    """Check that Dask is installed.

    Raises:
        DaskError: Dask is not installed; the text has the command that installs it.
    """
    if find_spec("distributed") is None:
        raise DaskError("--scheduler needs the package distributed: pip install 'ctr-station[dask]'")


@contextmanager
def cluster(scheduler: str, workers: int, report: Callable[[str], None]) -> Iterator["Client"]:
    """Connect to the scheduler at an address, or with `LOCAL` start this many local workers; return the Dask client.

    `report` receives a line with the address and the dashboard of the scheduler.

    Raises:
        DaskError: no scheduler answers.
    """
    check_dask()
    with ExitStack() as ends:
        client = _client(scheduler, workers, ends)
        info = client.scheduler_info(n_workers=-1)
        page = client.dashboard_link if "dashboard" in info["services"] else "none"
        report(f"Dask at {info['address']}: {len(info['workers'])} workers; dashboard: {page}")
        yield client


def run_on_cluster(
    client: "Client",
    work: Callable[[T], R],
    listed: Sequence[T],
    keep: Callable[[R], None],
    lost: Callable[[T], R],
    report_done: Callable[[float], None] = lambda _: None,
) -> None:
    """Carry out the jobs on a cluster until all are done, or until Ctrl-C.

    Args:
        client: client of the cluster.
        work: function that a worker calls with each job.
        listed: the jobs.
        keep: receives each result.
        lost: returns a result for a job that ended every worker on which it ran.
        report_done: receives the number of finished jobs.

    Raises:
        DaskError: the scheduler is gone, or its workers cannot carry out jobs.
    """
    finished: SimpleQueue[Future] = SimpleQueue()
    waiting, on, done = iter(range(len(listed))), dict[Any, int](), 0
    suspected, alone = list[int](), set[int]()

    def submit(numbers: Iterable[int]) -> None:
        for number in numbers:
            sent = pickle.dumps(_Sent(work, listed[number]))
            future = client.submit(pickle.loads, sent, key=f"run-{uuid4().hex}")
            on[future] = number
            future.add_done_callback(finished.put)

    with interrupts() as interrupted:
        submit(islice(waiting, MAX_QUEUED_JOBS))
        while (on or suspected) and not interrupted():
            if not on:  # any job of an ended worker may be the cause of its end, so each job now runs alone
                alone.add(suspected[-1])
                submit([suspected.pop()])
            try:
                future = finished.get(timeout=PROGRESS_INTERVAL_S)
            except Empty:
                continue
            number = on.pop(future)
            submit(islice(waiting, 1))
            survived, result = _result(future)
            if not survived and number not in alone:
                suspected.append(number)
                continue
            keep(result if survived else lost(listed[number]))
            done += 1
            report_done(done)
        client.cancel(list(on))


def _client(scheduler: str, workers: int, ends: ExitStack) -> "Client":
    from distributed import Client, LocalCluster
    from distributed.security import Security

    try:
        if scheduler != LOCAL:
            return ends.enter_context(Client(scheduler, timeout=SCHEDULER_TIMEOUT_S))
        # Each worker process has one thread, because a job needs a whole process. A scheduler executes whatever a
        # client sends, and every user of this computer can connect to its loopback port. So client and workers must
        # present the temporary certificate of this cluster.
        security = Security.temporary()
        local = LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0", protocol="tls://",
            host="127.0.0.1", security=security,
        )  # fmt: skip
        return ends.enter_context(Client(ends.enter_context(local), security=security))
    except ImportError as error:  # the package cryptography is missing
        raise DaskError(f"--scheduler {scheduler}: {error}; pip install 'ctr-station[dask]'") from None
    except (OSError, ValueError, TypeError) as error:
        raise DaskError(f"--scheduler {scheduler}: no Dask scheduler answers at this address: {error}") from None


def _result(future: "Future") -> tuple[bool, Any]:
    """Return whether a job's worker survived the job, and the job's result.

    If a result was lost with its worker, this function waits until the scheduler has repeated the job.
    """
    from distributed import KilledWorker

    try:
        return True, future.result()
    except KilledWorker:
        return False, None
    except CancelledError:
        raise DaskError("the scheduler is gone; results are stored, and the same command continues") from None
    except Exception as error:
        raise DaskError(
            f"a worker cannot carry out runs: {type(error).__name__}: {error}; install this client's ctr-station there"
        ) from error


_ONE = Lock()


class _Sent:
    """Pickled form of a job; unpickling it on a worker carries out the job.

    A worker on which ctr-station is not installed then fails inside the task and reports the reason. A worker
    that cannot unpickle the task itself would end without a reason.
    """

    def __init__(self, work: Callable[[Any], Any], job: Any) -> None:
        self._work, self._job = work, job

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, Any]]:
        return _run_job, (self._work, self._job)


def _run_job(work: Callable[[Any], Any], job: Any) -> Any:
    """Carry out a job on a worker; a lock allows one job at a time, however many threads the worker has."""
    with _ONE:
        return work(job)


#: Cause in the row of a run that ended every worker on which it was tried.
WORKER_LOST = "its worker ended before the run was done, repeatedly and also without another run: too little memory?"


def on_dask(
    listed: Sequence[SweepJob],
    scheduler: str,
    workers: int,
    keep: Callable[[Row], None],
    report_done: Callable[[float], None],
    report: Callable[[str], None],
) -> None:
    """Carry out the runs of a sweep on a Dask cluster until all are done, or until Ctrl-C.

    Args:
        listed: the runs.
        scheduler: address of the scheduler, or `LOCAL`.
        workers: number of local worker processes.
        keep: receives the row of each finished run.
        report_done: receives the number of finished runs.
        report: receives a line with the address and the dashboard of the cluster.

    Raises:
        DaskError: no scheduler answers, the scheduler is gone, or its workers cannot carry out runs.
    """
    with cluster(scheduler, workers, report) as client:
        run_on_cluster(client, _run_without_progress, listed, keep, lambda job: failed(job, WORKER_LOST), report_done)


def _run_without_progress(job: SweepJob) -> Row:
    return run_job(job, lambda _: None)
