"""Search over the parameters of a study with the differential evolution of scipy.

An engine evaluates the candidate robots of each generation in parallel. With the same seed a search requests the same
candidates in the same order. So a search that was stopped reads the stored candidates from their file and
evaluates only the missing ones.
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
from station.design.task import MAX_LOAD_RATIO, cost, evaluate

#: Cost of a candidate that is not a valid robot or fails; it is larger than the cost of any evaluated robot.
IMPOSSIBLE_COST = 2e3


class Candidate(NamedTuple):
    """Candidate robot with everything that its evaluation needs, on this or another computer."""

    parameters: tuple[float, ...]
    robot: RobotFile | None  #: candidate robot; None if its parameters give no valid robot
    task: StudyTaskFile
    objective: Objective
    why: str  #: reason why the parameters give no valid robot


class SearchEngine(Protocol):
    """Function that evaluates candidates in parallel; `keep` receives each result. Ctrl-C ends it early."""

    def __call__(self, candidates: Sequence[Candidate], keep: Callable[[Line], None]) -> None: ...  # noqa: D102


class SearchStopped(CtrError):
    """Ctrl-C ended the search; all evaluated candidates are stored."""


def evaluate_candidate(candidate: Candidate, progress: Callable[[float], None] = lambda _: None) -> Line:
    """Evaluate a candidate and return its line with its cost; if the evaluation fails, the line has the reason."""
    about: dict[str, Any] = {"parameters": list(candidate.parameters)}
    if candidate.robot is None:
        return {**about, "cost": IMPOSSIBLE_COST, "why": candidate.why}
    try:
        max_ratio = MAX_LOAD_RATIO if candidate.objective == "load" else 1.0
        outcome = evaluate(candidate.robot, candidate.task, candidate.objective, max_ratio)
    except CtrError as error:
        return {**about, "cost": IMPOSSIBLE_COST, "why": str(error)}
    finally:
        progress(1.0)
    nominal = outcome.nominal
    least = {} if nominal is None else {
        "margin": float(nominal.margins.min()),
        "dexterity": float(nominal.dexterities.min()),
        "stiffness": float(nominal.stiffnesses.min()),
    }  # fmt: skip
    return {**about, "cost": cost(outcome, candidate.objective), "load": outcome.load, **least, "why": outcome.why}


def search(study: Study, candidates: Candidates, engine: SearchEngine, report: Callable[[int], None]) -> list[Line]:
    """Carry out a search and return the lines of its candidates in its order; the first candidate is the start robot.

    Args:
        study: study to search.
        candidates: stored candidates; new ones are added.
        engine: function that evaluates candidates.
        report: receives the number of evaluated candidates.

    Raises:
        SearchStopped: the user pressed Ctrl-C.

    """
    evaluated: list[Line] = []

    def costs(rows: Sequence[Array]) -> list[float]:
        """Return the costs of the candidates of a generation."""
        requested = [tuple(np.asarray(row, np.float64).tolist()) for row in rows]
        new = [values for values in dict.fromkeys(requested) if values not in candidates.lines]

        def keep(line: Line) -> None:
            candidates.append(line)
            report(len(evaluated) + sum(values in candidates.lines for values in requested))

        if new:
            engine([_candidate(study, values) for values in new], keep)
        if any(values not in candidates.lines for values in requested):
            raise SearchStopped(f"stopped after {len(candidates.lines)} candidates; the same command continues")
        evaluated.extend(candidates.lines[values] for values in requested)
        report(len(evaluated))
        return [candidates.lines[values]["cost"] for values in requested]

    def spread(_: Callable[[Array], float], rows: Iterable[Array]) -> list[float]:
        return costs(list(rows))

    lower, upper = np.array(study.bounds).T
    start = np.clip(study.start_parameters, lower, upper)
    file = study.file.search
    costs([study.start_parameters])
    differential_evolution(
        _never, study.bounds, popsize=file.population, maxiter=file.generations, tol=0.0, polish=False,
        init="halton", updating="deferred", workers=spread, x0=start, rng=file.seed,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    return evaluated


def planned(study: Study) -> int:
    """Return the largest number of candidates that a search evaluates."""
    size = max(5, study.file.search.population * len(study.bounds))
    return 1 + size * (study.file.search.generations + 1)


def _candidate(study: Study, values: tuple[float, ...]) -> Candidate:
    task, objective = study.file.task, study.file.objective
    try:
        return Candidate(values, study.changed(values), task, objective, "")
    except CtrError as error:
        return Candidate(values, None, task, objective, str(error))


def _never(values: Array) -> float:
    raise AssertionError(f"{values} must be evaluated by the engine")
