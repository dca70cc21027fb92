"""A sweep's runs on a Dask cluster. Needs the extra `dask`."""

from collections.abc import Callable, Sequence

from station.experiments.manifest import Row
from station.experiments.on_cluster import carry_out, cluster
from station.experiments.sweep import failed, run_job
from station.experiments.sweep_plan import Job

#: Why a run failed that no worker has survived.
LOST = "its worker was lost in the middle of it, time after time, also when it had no other run: too little memory?"


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
    with cluster(scheduler, workers, say) as client:
        carry_out(client, _quietly, listed, keep, lambda job: failed(job, LOST), told)


def _quietly(job: Job) -> Row:
    return run_job(job, lambda _: None)
