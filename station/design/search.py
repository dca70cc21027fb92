"""Search over the parameters of a study with the differential evolution of scipy.

The candidate robots of each generation are evaluated in parallel. With the same seed a search requests the same
candidates in the same order. So a search that was stopped reads the stored candidates from their manifest and
evaluates only the missing ones.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.design.study import Objective, Study, StudyTaskFile
from station.design.task import MAX_LOAD_RATIO, cost, evaluate
from station.jobs.manifest import Manifest
from station.jobs.run_jobs import LOST, Work, Workers, run_jobs
from station.recording.metadata import PACKAGES, versions

CANDIDATES_FILE = "candidates.jsonl"
#: Values of the searched parameters, which identify a candidate.
Parameters = tuple[float, ...]
#: Line of a candidate: its `parameters` (p,), its `cost`, and the numbers from which the cost was computed.
Line = Mapping[str, Any]


def candidates_file(folder: Path, study: Study) -> Manifest[Parameters]:
    """Create the manifest of a search with the evaluated candidates, or continue an existing one.

    Raises:
        RecordingError: the folder has another study, another process uses it, the file is invalid, or the disk is full.
    """
    return Manifest(folder / CANDIDATES_FILE, plan_of(study), lambda line: tuple(line["parameters"]))


def plan_of(study: Study) -> dict[str, Any]:
    """Return what identifies a search as a JSON object: study, digest of the robot, and versions of packages."""
    found = versions()
    robot = hashlib.sha256(study.robot.model_dump_json().encode()).hexdigest()
    return {
        "study": study.file.model_dump(mode="json"),
        "robot": robot,
        "versions": {name: found[name] for name in PACKAGES},
    }


def parameters_of(study: Study, line: Line) -> dict[str, float]:
    """Return the parameters of a candidate by key of the robot's file."""
    return dict(zip([each.key for each in study.file.parameters], line["parameters"], strict=True))


def best(lines: Sequence[Line]) -> Line:
    """Return the candidate with the smallest cost; if several have it, the first of them."""
    return min(lines, key=lambda line: line["cost"])


#: Cost of a candidate that is not a valid robot or fails; it is larger than the cost of any evaluated robot.
IMPOSSIBLE_COST = 2e3


class Candidate(NamedTuple):
    """Candidate robot with everything that its evaluation needs, on this or another computer."""

    parameters: Parameters
    robot: RobotFile | None  #: candidate robot; None if its parameters give no valid robot
    task: StudyTaskFile
    objective: Objective
    why: str  #: reason why the parameters give no valid robot

    def impossible(self, why: str) -> Line:
        """Return the line of a candidate without a result, with the reason."""
        return {"parameters": list(self.parameters), "cost": IMPOSSIBLE_COST, "why": why}


def evaluate_candidate(candidate: Candidate, _progress: Callable[[float], None]) -> Line:
    """Evaluate a candidate and return its line with its cost; if the evaluation fails, the line has the reason."""
    if candidate.robot is None:
        return candidate.impossible(candidate.why)
    try:
        max_ratio = MAX_LOAD_RATIO if candidate.objective == "load" else 1.0
        outcome = evaluate(candidate.robot, candidate.task, candidate.objective, max_ratio)
    except CtrError as error:
        return candidate.impossible(str(error))
    nominal = outcome.nominal
    least = {} if nominal is None else {
        "margin": float(nominal.margins.min()),
        "dexterity": float(nominal.dexterities.min()),
        "stiffness": float(nominal.stiffnesses.min()),
    }  # fmt: skip
    about = {"parameters": list(candidate.parameters), "cost": cost(outcome, candidate.objective), "load": outcome.load}
    return {**about, **least, "why": outcome.why}


def search(
    study: Study,
    stored: Manifest[Parameters],
    workers: Workers | None,
    report: Callable[[int], None],
    work: Work[Candidate, Line] = evaluate_candidate,
) -> list[Line]:
    """Carry out a search and return the lines of its candidates in its order; the first candidate is the start robot.

    Args:
        study: study to search.
        stored: stored candidates; new ones are added.
        workers: where candidates are evaluated; None: in this process.
        report: receives the number of evaluated candidates.
        work: function that evaluates a candidate.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C; all evaluated candidates are stored.
    """
    evaluated: list[Line] = []

    def costs(rows: Sequence[Array]) -> list[float]:
        """Return the costs of the candidates of a generation."""
        requested = [tuple(np.asarray(row, np.float64).tolist()) for row in rows]
        jobs = {values: _candidate(study, values) for values in requested}
        run_jobs(
            work, jobs, workers, stored,
            lambda _: report(len(evaluated) + sum(values in stored for values in requested)),
            lost=lambda candidate: candidate.impossible(LOST),
        )  # fmt: skip
        if any(values not in stored for values in requested):
            raise KeyboardInterrupt
        evaluated.extend(stored.rows[values] for values in requested)
        report(len(evaluated))
        return [stored.rows[values]["cost"] for values in requested]

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


def _candidate(study: Study, values: Parameters) -> Candidate:
    task, objective = study.file.task, study.file.objective
    try:
        return Candidate(values, study.changed(values), task, objective, "")
    except CtrError as error:
        return Candidate(values, None, task, objective, str(error))


def _never(values: Array) -> float:
    raise AssertionError(f"{values} must be evaluated by `work`")
