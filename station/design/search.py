"""Search over the parameters of a study with the differential evolution of scipy.

An engine evaluates the candidate robots of each generation in parallel. With the same seed a search requests the same
candidates in the same order. So a search that was stopped reads the stored candidates from their file and
evaluates only the missing ones.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from scipy.optimize import differential_evolution

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.design.study import Objective, Study, StudyTaskFile
from station.design.task import MAX_LOAD_RATIO, cost, evaluate
from station.experiments.dask_cluster import cluster, run_on_cluster
from station.experiments.job_pool import JobPool, run_serially
from station.recording.line_store import KeptLines, complete_lines
from station.recording.metadata import PACKAGES, versions

CANDIDATES_FILE = "candidates.jsonl"
#: Line of a candidate: its `parameters` (p,), its `cost`, and the numbers from which the cost was computed.
Line = Mapping[str, Any]


class Candidates:
    """File with the candidates of one search, locked until it is closed.

    The first line identifies the search; every other line is an evaluated robot. A kill or a full disk may leave an
    incomplete last line; the next search drops this line and evaluates its candidate again.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        """Create the file, or continue an existing one.

        Raises:
            ConfigError: the folder has another study.
            RecordingError: another process uses the folder, the file is invalid, or the disk is full.

        """
        self.path, self.lines = folder / CANDIDATES_FILE, dict[tuple[float, ...], Line]()
        plan = plan_of(study)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = KeptLines(self.path, "searches in this folder")
        except OSError as error:
            raise ConfigError(f"{folder}: cannot write results: {error.strerror}") from None
        try:
            self._read(plan)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close and unlock the file."""
        self._file.close()

    def append(self, line: Line) -> None:
        """Store an evaluated candidate as a line of the file.

        Raises:
            RecordingError: the line cannot be written.

        """
        self._file.append(line)
        self.lines[tuple(line["parameters"])] = line

    def _read(self, plan: Mapping[str, Any]) -> None:
        kept, self._file.length = complete_lines(self.path, self.path.read_bytes())
        try:
            self.lines = {tuple(line["parameters"]): line for line in kept[1:] if line["cost"] is not None}
        except (KeyError, TypeError):
            raise ConfigError(f"{self.path}: not a list of candidates; repair it, or choose another folder") from None
        if not kept:
            self._file.append(plan)
        elif kept[0] != plan:
            names = ", ".join(name for name in plan if kept[0].get(name) != plan[name])
            raise ConfigError(f"{self.path}: the folder has another search ({names} differ); choose another folder")


def plan_of(study: Study) -> dict[str, Any]:
    """Return everything that identifies a search, ready for JSON."""
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
