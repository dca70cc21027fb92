"""Workers of a Dask cluster, which is remote or consists of processes on this computer. Needs the extra `dask`.

The scheduler moves the jobs of a lost worker to other workers. The client stores each result on its disk, so results
survive the loss of the whole cluster.
"""

import pickle
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from threading import Lock
from typing import TYPE_CHECKING, Any

from core.errors import CtrError

if TYPE_CHECKING:
    from distributed import Client

#: Value of `--scheduler` that starts local worker processes instead of connecting to an address.
LOCAL = "local"
#: Longest time to wait until a scheduler answers a new connection [s].
SCHEDULER_TIMEOUT_S = 10.0


class DaskError(CtrError):
    """Dask is not installed, no scheduler answers, or the workers cannot carry out jobs."""


def has_dask() -> bool:
    """Return whether Dask is installed."""
    return find_spec("distributed") is not None


class DaskWorkers:
    """Workers of a Dask cluster (`run_jobs.Workers`)."""

    #: Largest number of jobs that the scheduler has: enough for any cluster, and small enough for its memory.
    at_a_time = 1000

    def __init__(self, client: "Client") -> None:
        self._executor = client.get_executor(pure=False)  # equal jobs are different jobs

    def submit(self, work: Callable[[Any, Callable[[float], None]], Any], job: Any) -> Future[Any]:
        """Send a job to the scheduler."""
        return self._executor.submit(pickle.loads, pickle.dumps(_SentJob(work, job)))

    def fractions(self) -> Mapping[Future[Any], float]:
        """Return an empty mapping, because a worker reports only results."""
        return {}

    def interrupt(self) -> None:
        """Do nothing: a cancelled job ends with its worker."""

    def raise_unless_lost(self, error: Exception) -> None:
        """Raise the reason why a job has no result; return if the job was lost because its workers have ended."""
        from distributed import KilledWorker

        if isinstance(error, CancelledError):
            raise DaskError("the scheduler is gone; the results are stored; repeat the command to continue") from None
        if not isinstance(error, KilledWorker):
            name = type(error).__name__
            raise DaskError(f"a worker cannot carry out jobs: {name}: {error}; install this ctr-station on all workers")


@contextmanager
def dask_workers(scheduler: str, count: int, report: Callable[[str], None]) -> Iterator[DaskWorkers]:
    """Connect to the scheduler at an address, or with `LOCAL` start `count` local workers.

    `report` receives a line with the address and the dashboard of the scheduler.

    Raises:
        DaskError: no scheduler answers.
    """
    with ExitStack() as ends:
        client = _client(scheduler, count, ends)
        info = client.scheduler_info(n_workers=-1)
        page = client.dashboard_link if "dashboard" in info["services"] else "none"
        report(f"Dask at {info['address']}: {len(info['workers'])} workers; dashboard: {page}")
        yield DaskWorkers(client)


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


class _SentJob:
    """Pickled form of a job; unpickling it on a worker carries out the job.

    A worker on which ctr-station is not installed then fails inside the task and reports the reason. A worker
    that cannot unpickle the task itself would end without a reason.
    """

    def __init__(self, work: Callable[..., Any], job: Any) -> None:
        self._work, self._job = work, job

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, Any]]:
        return _carry_out, (self._work, self._job)


_ONE = Lock()


def _carry_out(work: Callable[..., Any], job: Any) -> Any:
    """Carry out a job on a worker; a lock allows one job at a time, even if the worker has several threads."""
    with _ONE:
        return work(job, lambda _: None)
