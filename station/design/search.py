"""The search: differential evolution (scipy) over a study's parameters, its generations spread by an engine.

With its seed it asks for the same candidates in the same order: one that was stopped walks through those that it has
kept, and goes on behind them.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import differential_evolution

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.candidates import Candidates, Line
from station.design.study import Objective, Study, StudyTaskFile
from station.design.task import MOST_LOAD, cost, done

#: Of candidates that cannot even be: more than any that can.
NONE = 2e3


class Candidate(NamedTuple):
    """One that is to be looked at, here or on another computer."""

    parameters: tuple[float, ...]
    robot: RobotFile | None  #: None: it cannot be
    task: StudyTaskFile
    objective: Objective
    why: str  #: it cannot be


class Engine(Protocol):
    """Looks at candidates side by side: `keep` each that is done. Fewer than all: Ctrl-C."""

    def __call__(self, candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None: ...  # noqa: D102


class Stopped(CtrError):
    """Ctrl-C: what is done is kept."""


def look(candidate: Candidate, progress: Callable[[float], None] = lambda _: None) -> Line:
    """What one is worth; one that fails is a line with its reason."""
    about: dict[str, Any] = {"parameters": list(candidate.parameters)}
    if candidate.robot is None:
        return {**about, "cost": NONE, "why": candidate.why}
    try:
        most = MOST_LOAD if candidate.objective == "load" else 1.0
        outcome = done(candidate.robot, candidate.task, candidate.objective, most)
    except CtrError as error:
        return {**about, "cost": NONE, "why": str(error)}
    finally:
        progress(1.0)
    held = outcome.held
    least = {} if held is None else {
        "margin": float(held.margins.min()),
        "dexterity": float(held.dexterities.min()),
        "stiffness": float(held.stiffnesses.min()),
    }  # fmt: skip
    return {**about, "cost": cost(outcome, candidate.objective), "load": outcome.load, **least, "why": outcome.why}


def search(study: Study, candidates: Candidates, engine: Engine, told: Callable[[int], None]) -> list[Line]:
    """All candidates, in the order in which the search asked for them, the robot that it begins from first.

    Args:
        study: what is searched.
        candidates: those that are known, and where others are kept.
        engine: looks at them.
        told: how many have been asked for.

    Raises:
        Stopped: Ctrl-C.

    """
    asked: list[Line] = []

    def costs(rows: Sequence[Array]) -> list[float]:
        """Of a generation."""
        wanted = [tuple(np.asarray(row, np.float64).tolist()) for row in rows]
        new = [values for values in dict.fromkeys(wanted) if values not in candidates.lines]

        def keep(line: Line) -> None:
            candidates.append(line)
            told(len(asked) + sum(values in candidates.lines for values in wanted))

        if new:
            engine([_candidate(study, values) for values in new], keep)
        if any(values not in candidates.lines for values in wanted):
            raise Stopped(f"stopped after {len(candidates.lines)} candidates; the same command goes on")
        asked.extend(candidates.lines[values] for values in wanted)
        told(len(asked))
        return [candidates.lines[values]["cost"] for values in wanted]

    def spread(_: Callable[[Array], float], rows: Iterable[Array]) -> list[float]:
        return costs(list(rows))

    lower, upper = np.array(study.bounds).T
    begun = np.clip(study.begun, lower, upper)
    file = study.file.search
    costs([study.begun])
    differential_evolution(
        _never, study.bounds, popsize=file.population, maxiter=file.generations, tol=0.0, polish=False,
        init="halton", updating="deferred", workers=spread, x0=begun, rng=file.seed,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    return asked


def planned(study: Study) -> int:
    """How many candidates a search asks for, at most."""
    size = max(5, study.file.search.population * len(study.bounds))
    return 1 + size * (study.file.search.generations + 1)


def _candidate(study: Study, values: tuple[float, ...]) -> Candidate:
    task, objective = study.file.task, study.file.objective
    try:
        return Candidate(values, study.changed(values), task, objective, "")
    except CtrError as error:
        return Candidate(values, None, task, objective, str(error))


def _never(values: Array) -> float:
    raise AssertionError(f"{values} is looked at by the engine")
