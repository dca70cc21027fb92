"""Engines that evaluate a generation of candidate robots: local processes, or a Dask cluster as in a sweep."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from station.design.candidates import Line
from station.design.search import IMPOSSIBLE_COST, Candidate, SearchEngine, evaluate_candidate
from station.experiments.dask_cluster import cluster, run_on_cluster
from station.experiments.job_pool import JobPool, run_serially

#: Reason in the line of a candidate whose evaluation ended every worker on which it was tried.
WORKER_LOST = "its worker ended before the evaluation was done, repeatedly: too little memory?"


@contextmanager
def search_engine(jobs: int, scheduler: str | None, report: Callable[[str], None]) -> Iterator[SearchEngine]:
    """Yield a search engine: `jobs` processes, or a Dask cluster at the address `scheduler` (`local`: `jobs` workers).

    `report` receives a line with the address of the cluster.

    Raises:
        DaskError: no scheduler answers, or the scheduler is gone.
        ProcessLost: a worker process was killed; repeating the same command continues the search.

    """
    if scheduler is not None:
        with cluster(scheduler, jobs, report) as client:
            yield lambda candidates, keep: run_on_cluster(client, evaluate_candidate, candidates, keep, _lost)
    elif jobs == 1:
        yield _local
    else:
        with JobPool(jobs) as started:

            def on_processes(candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None:
                started.carry_out(evaluate_candidate, candidates, lambda _: None, lambda line: _kept(line, keep))

            yield on_processes


def _local(candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None:
    run_serially(evaluate_candidate, candidates, lambda _: None, lambda line: _kept(line, keep))


def _kept(line: Line, keep: Callable[[Line], None]) -> bool:
    keep(line)
    return True


def _lost(candidate: Candidate) -> Line:
    return {"parameters": list(candidate.parameters), "cost": IMPOSSIBLE_COST, "why": WORKER_LOST}
