"""REST: the queue of runs, which starts the next run when the previous one is complete."""

from functools import partial
from typing import Annotated, Literal

from fastapi import APIRouter, Depends
from pydantic import ConfigDict, Field

from station.config.loads import NoLoad
from station.config.strict import Strict
from station.control.commands import RequestError
from station.experiments.case_summary import case_words, describe_keys, motion_title
from station.experiments.experiment import Case, offered_experiment
from station.service.commands import Start, experiment_start
from station.service.feasibility import incompatibility
from station.service.run_queue import QueueEntry, RunQueue
from station.service.supervisor import Supervisor
from web.api.commands import Commands, Permitted
from web.api.schemas import REFUSED_RESPONSES

#: Largest number of repetitions of a request.
MAX_REPEATS = 50


class QueueIn(Start):
    """Runs to add: one free motion, one case of an experiment, or (without `case`) all its cases that can run here."""

    repeat: Annotated[int, Field(ge=1, le=MAX_REPEATS)] = 1
    """how often the whole request is added"""


class QueueEntryOut(Strict):
    """One run of the queue."""

    id: int
    title: str
    state: Literal["waiting", "running", "done", "failed"]
    run: str
    """id of the run; empty before its start"""
    reason: str
    """why the run failed"""
    by_hand: str
    """what a person must do before the run; empty: nothing"""


class QueueOut(Strict):
    """The queue of runs."""

    paused: str
    """why the queue starts no run now; empty while it starts runs"""
    entries: tuple[QueueEntryOut, ...]


class MoveIn(Strict):
    """Move a waiting run within the queue."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"by": -1}]})

    by: Annotated[int, Field(ge=-1000, le=1000)]
    """number of positions; negative: towards the start of the queue"""


def queue_routes(supervisor: Supervisor, queue: RunQueue, of: Commands) -> APIRouter:
    """Return the REST routes under /api/queue."""
    router = APIRouter(
        prefix="/api/queue",
        tags=["queue"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422]},
    )
    real = supervisor.bench.devices is not None

    def out() -> QueueOut:
        entries = tuple(
            QueueEntryOut(id=e.id, title=e.title, state=e.state.value, run=e.run, reason=e.reason, by_hand=e.by_hand)
            for e in queue.entries
        )
        return QueueOut(paused=queue.paused, entries=entries)

    unfit = partial(incompatibility, bench=supervisor.bench)

    def of_case(name: str, experiment_title: str, case: Case) -> QueueEntry:
        by_hand = f"prepare the load, and attach it after the motion has started: {describe_keys(case.file.load)}"
        return QueueEntry(
            f"{name.replace('_', ' ')}: {case_words(case, experiment_title)}",
            Start(experiment=name, case=case.name),
            by_hand if real and not isinstance(case.file.load, NoLoad) else "",
        )

    def runs_of(request: QueueIn) -> list[QueueEntry]:
        if request.experiment is not None:
            experiment = offered_experiment(request.experiment, supervisor.bench.robot_name, check_motions=False)
            if request.case is not None:
                experiment_start(supervisor, request.experiment, request.case)  # refuses an unknown case
            cases = [case for case in experiment.cases if request.case in (None, case.name)]
            found = [of_case(experiment.name, experiment.title, case) for case in cases if not unfit(case)]
            if not found:
                raise RequestError(f"no case of {request.experiment} can run on this station: {unfit(cases[0])}")
            return found
        settings = supervisor.settings.changed_by(request)
        return [QueueEntry(motion_title(settings.trajectory, settings.load), Start(**dict(settings)))]

    @router.get("", summary="The queue of runs")
    def get() -> QueueOut:
        """Return waiting, running and finished runs in their order, and why the queue is paused."""
        return out()

    @router.post("", summary="Add runs at the end; a queue without waiting runs starts at once", **of.command)
    def add(request: QueueIn, permit: Permitted) -> QueueOut:
        """Add runs to the queue; each run is checked when it starts, not when it is added."""
        queue.add(request.repeat * runs_of(request), permit)
        return out()

    @router.post("/pause", summary="Start no further run; the present run continues", **of.command)
    def pause() -> QueueOut:
        """Pause the queue; the present run continues, and waiting runs keep their order."""
        queue.pause("paused by the operator")
        return out()

    @router.post("/resume", summary="Continue with the next waiting run", **of.command)
    def resume(permit: Permitted) -> QueueOut:
        """Resume the queue, which starts runs while the client that has resumed it stays operator."""
        queue.resume(permit)
        return out()

    @router.post("/{entry}/move", summary="Move a waiting run", **of.command)
    def move(entry: int, request: MoveIn) -> QueueOut:
        """Move a run among the waiting runs."""
        queue.move(entry, request.by)
        return out()

    @router.delete("/{entry}", summary="Remove a run that is not running", **of.command)
    def remove(entry: int) -> QueueOut:
        """Remove a run that is not running; STOP ends a running one."""
        queue.remove(entry)
        return out()

    @router.delete("", summary="Remove every run that is not running", **of.command)
    def clear() -> QueueOut:
        """Remove all runs that are not running; a running one continues."""
        queue.clear()
        return out()

    return router
