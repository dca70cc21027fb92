"""Who looks at a generation of candidates: processes here, or a Dask cluster, as for a sweep."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from station.design.candidates import Line
from station.design.search import NONE, Candidate, Engine, look
from station.experiments.on_cluster import carry_out, cluster
from station.experiments.side_by_side import Processes, one_after_the_other

#: Of a candidate that no worker has survived.
LOST = "its worker was lost in the middle of it, time after time: too little memory?"


@contextmanager
def engine(jobs: int, scheduler: str | None, say: Callable[[str], None]) -> Iterator[Engine]:
    """So many processes, or a Dask cluster at an address (`local`: so many workers here); `say` where that is.

    Raises:
        DaskError: no scheduler answers, or it has gone.
        ProcessLost: a process was killed; the same command goes on.

    """
    if scheduler is not None:
        with cluster(scheduler, jobs, say) as client:
            yield lambda candidates, keep: carry_out(client, look, candidates, keep, _lost)
    elif jobs == 1:
        yield _here
    else:
        with Processes(jobs) as started:

            def on_processes(candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None:
                started.carry_out(look, candidates, lambda _: None, lambda line: _kept(line, keep))

            yield on_processes


def _here(candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None:
    one_after_the_other(look, candidates, lambda _: None, lambda line: _kept(line, keep))


def _kept(line: Line, keep: Callable[[Line], None]) -> bool:
    keep(line)
    return True


def _lost(candidate: Candidate) -> Line:
    return {"parameters": list(candidate.parameters), "cost": NONE, "why": LOST}
