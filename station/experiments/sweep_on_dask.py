"""A sweep's runs on a Dask cluster: whatever Dask runs on, or worker processes here. Needs the extra `dask`.

The scheduler gives the runs of a lost worker to others. What has been done is kept here, not there: the cluster may
forget all of it.
"""

import pickle
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack
from importlib.util import find_spec
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from core.errors import CtrError
from station.experiments.interrupt import interrupts
from station.experiments.manifest import Row
from station.experiments.side_by_side import LOOK
from station.experiments.sweep import failed, run_job
from station.experiments.sweep_plan import Job

if TYPE_CHECKING:
    from distributed import Client, Future

#: Instead of a scheduler's address: worker processes here.
LOCAL = "local"
#: Runs that the scheduler has at a time: enough for any cluster, and no memory filled with what is far ahead.
AHEAD = 1000
#: In which a scheduler must answer [s].
ANSWER = 10.0
#: Why a run failed that no worker has survived.
LOST = "its worker was lost in the middle of it, time after time, also when it had no other run: too little memory?"


class DaskError(CtrError):
    """No Dask, no scheduler, or one that cannot carry out runs."""


def check_dask() -> None:
    """See that it is installed.

    Raises:
        DaskError: it is not; the text says what to install.
    """
    if find_spec("distributed") is None:
        raise DaskError("--scheduler needs the package distributed: pip install 'ctr-station[dask]'")


def on_dask(
    listed: Sequence[Job],
    scheduler: str,
    workers: int,
    keep: Callable[[Row], None],
    told: Callable[[float], None],
    say: Callable[[str], None],
) -> None:
    """Carry out all of `listed`: `keep` each that is done, `told` how many are; Ctrl-C leaves out the others.

    Args:
        listed: the runs.
        scheduler: its address, or `LOCAL`.
        workers: number of worker processes here.
        keep, told: of what is done.
        say: where the cluster is, and its dashboard.

    Raises:
        DaskError: no scheduler answers, it has gone, or what it has cannot carry out runs.
    """
    check_dask()
    with ExitStack() as ends:
        client = _client(scheduler, workers, ends)
        info = client.scheduler_info(n_workers=-1)
        page = client.dashboard_link if "dashboard" in info["services"] else "none"
        say(f"Dask at {info['address']}: {len(info['workers'])} workers; dashboard: {page}")
        finished: SimpleQueue[Future] = SimpleQueue()
        waiting, on, done = iter(listed), dict[Any, Job](), 0
        suspected, alone = list[Job](), set[int]()

        def submit(jobs: Iterable[Job]) -> None:
            for job in jobs:
                future = client.submit(pickle.loads, pickle.dumps(_Sent(job)), key=f"run-{uuid4().hex}")
                on[future] = job
                future.add_done_callback(finished.put)

        with interrupts() as interrupted:
            submit(islice(waiting, AHEAD))
            while (on or suspected) and not interrupted():
                if not on:  # a worker's end counts against all that it was given
                    alone.add(suspected[-1].run)
                    submit([suspected.pop()])
                try:
                    future = finished.get(timeout=LOOK)
                except Empty:
                    continue
                job = on.pop(future)
                submit(islice(waiting, 1))
                row = _row(future)
                if row is None and job.run not in alone:
                    suspected.append(job)
                    continue
                keep(row or failed(job, LOST))
                done += 1
                told(done)
            client.cancel(list(on))


def _client(scheduler: str, workers: int, ends: ExitStack) -> "Client":
    from distributed import Client, LocalCluster

    try:
        if scheduler != LOCAL:
            return ends.enter_context(Client(scheduler, timeout=ANSWER))
        # A run is a process's work, not a thread's; and nobody but this computer sees the dashboard.
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")
        return ends.enter_context(Client(ends.enter_context(cluster)))
    except (OSError, ValueError, TypeError) as error:
        raise DaskError(f"--scheduler {scheduler}: no Dask scheduler answers there: {error}") from None


def _row(future: "Future") -> Row | None:
    """What came of a run; None: its worker was lost time after time.

    A result that was lost with its worker before it came here is waited for: the scheduler has it made again.
    """
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return None
    except CancelledError:
        raise DaskError("the scheduler has gone; what is done is kept, and the same command goes on") from None
    except Exception as error:
        raise DaskError(
            f"a worker cannot carry out runs: {type(error).__name__}: {error}; it needs the same ctr-station as here"
        ) from error


_ONE = Lock()


class _Sent:
    """A run on its way: unpickling it, on a worker, is carrying it out.

    So a worker without the station fails in its task, and tells why; it would end if it could not even read the task.
    """

    def __init__(self, job: Job) -> None:
        self._job = job

    def __reduce__(self) -> tuple[Callable[[Job], Row], tuple[Job]]:
        return _work, (self._job,)


def _work(job: Job) -> Row:
    """On a worker: one run at a time, however many threads it has."""
    with _ONE:
        return run_job(job, lambda _: None)
