"""Jobs on a Dask cluster: whatever Dask runs on, or worker processes here. Needs the extra `dask`.

The scheduler gives the jobs of a lost worker to others. What has been done is kept here, not there: the cluster may
forget all of it.
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
from station.experiments.interrupt import interrupts
from station.experiments.side_by_side import LOOK

if TYPE_CHECKING:
    from distributed import Client, Future

#: Instead of a scheduler's address: worker processes here.
LOCAL = "local"
#: Jobs that the scheduler has at a time: enough for any cluster, and no memory filled with what is far ahead.
AHEAD = 1000
#: In which a scheduler must answer [s].
ANSWER = 10.0

T = TypeVar("T")
R = TypeVar("R")


class DaskError(CtrError):
    """No Dask, no scheduler, or one that cannot carry out jobs."""


def check_dask() -> None:
    """See that it is installed.

    Raises:
        DaskError: it is not; the text says what to install.
    """
    if find_spec("distributed") is None:
        raise DaskError("--scheduler needs the package distributed: pip install 'ctr-station[dask]'")


@contextmanager
def cluster(scheduler: str, workers: int, say: Callable[[str], None]) -> Iterator["Client"]:
    """A client of the scheduler at an address, or with `LOCAL` of so many worker processes here.

    `say` where it is, and its dashboard.

    Raises:
        DaskError: no scheduler answers.
    """
    check_dask()
    with ExitStack() as ends:
        client = _client(scheduler, workers, ends)
        info = client.scheduler_info(n_workers=-1)
        page = client.dashboard_link if "dashboard" in info["services"] else "none"
        say(f"Dask at {info['address']}: {len(info['workers'])} workers; dashboard: {page}")
        yield client


def carry_out(
    client: "Client",
    work: Callable[[T], R],
    listed: Sequence[T],
    keep: Callable[[R], None],
    lost: Callable[[T], R],
    told: Callable[[float], None] = lambda _: None,
) -> None:
    """Carry out all of `listed`; Ctrl-C leaves out the others.

    Args:
        client: of the cluster.
        work: what is done with each, on a worker.
        listed: the jobs.
        keep: each result.
        lost: the result of one that no worker has survived.
        told: how many are done.

    Raises:
        DaskError: the scheduler has gone, or what it has cannot carry out jobs.
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
        submit(islice(waiting, AHEAD))
        while (on or suspected) and not interrupted():
            if not on:  # a worker's end counts against all that it was given
                alone.add(suspected[-1])
                submit([suspected.pop()])
            try:
                future = finished.get(timeout=LOOK)
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
            told(done)
        client.cancel(list(on))


def _client(scheduler: str, workers: int, ends: ExitStack) -> "Client":
    from distributed import Client, LocalCluster

    try:
        if scheduler != LOCAL:
            return ends.enter_context(Client(scheduler, timeout=ANSWER))
        # A job is a process's work, not a thread's; and nobody but this computer sees the dashboard.
        local = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")
        return ends.enter_context(Client(ends.enter_context(local)))
    except (OSError, ValueError, TypeError) as error:
        raise DaskError(f"--scheduler {scheduler}: no Dask scheduler answers there: {error}") from None


def _result(future: "Future") -> tuple[bool, Any]:
    """Whether a worker has survived a job, and what came of it.

    A result that was lost with its worker before it came here is waited for: the scheduler has it made again.
    """
    from distributed import KilledWorker

    try:
        return True, future.result()
    except KilledWorker:
        return False, None
    except CancelledError:
        raise DaskError("the scheduler has gone; what is done is kept, and the same command goes on") from None
    except Exception as error:
        raise DaskError(
            f"a worker cannot carry out runs: {type(error).__name__}: {error}; it needs the same ctr-station as here"
        ) from error


_ONE = Lock()


class _Sent:
    """A job on its way: unpickling it, on a worker, is carrying it out.

    So a worker without the station fails in its task, and tells why; it would end if it could not even read the task.
    """

    def __init__(self, work: Callable[[Any], Any], job: Any) -> None:
        self._work, self._job = work, job

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, Any]]:
        return _work, (self._work, self._job)


def _work(work: Callable[[Any], Any], job: Any) -> Any:
    """On a worker: one job at a time, however many threads it has."""
    with _ONE:
        return work(job)
