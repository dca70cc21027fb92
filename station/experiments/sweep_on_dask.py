"""Run a sweep on a Dask cluster. Needs the extra `dask`."""

from collections.abc import Callable, Sequence

from station.experiments.dask_cluster import cluster, run_on_cluster
from station.experiments.manifest import Row
from station.experiments.sweep import failed, run_job
from station.experiments.sweep_plan import SweepJob

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
