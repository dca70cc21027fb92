"""Many seeds of one experiment, as it is or with keys of its file set to each of several values.

Every run is a case in virtual time in a process of its own, bit for bit what `run` does with that seed.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from station.config.strict import ConfigError
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, Experiment, load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.experiments.side_by_side import Processes
from station.experiments.sweep_settings import Setting, nested

#: Numbers of a run that are the same for all seeds, or the computer's.
NO_RESULTS = ("wall_s", "simulated_s", "counted_from_s")


class Job(NamedTuple):
    """One run of a sweep."""

    setting: Setting
    case: Case
    seed: int


class Outcome(NamedTuple):
    """A run and its numbers."""

    job: Job
    numbers: Mapping[str, Any]  #: those of `summarise`


class Spread(NamedTuple):
    """One number over all seeds."""

    median: float
    worst: float
    p5: float
    p95: float


def jobs(experiment: str, chosen: Sequence[Setting], seeds: Sequence[int], only: str | None = None) -> list[Job]:
    """All runs, after the experiment has been checked whole with every setting.

    Args:
        experiment: preset or file.
        chosen: what is set on top of every case.
        seeds: of everything random in the virtual lab.
        only: the one case to run; None: all.

    Raises:
        ConfigError: with file, case, key, value and what was expected.
    """
    listed: list[Job] = []
    for setting in chosen:
        cases = load_experiment(experiment, nested(setting)).cases
        if only is not None and only not in [case.name for case in cases]:
            raise ConfigError(f"--case {only}: the cases are {', '.join(case.name for case in cases)}")
        listed += [Job(setting, case, seed) for case in cases if only in (None, case.name) for seed in seeds]
    return listed


def run_job(job: Job, progress: Callable[[float], None]) -> Outcome:
    """One run."""
    return Outcome(job, summarise(run_case(job.case, job.seed, VirtualClock(), progress)))


def sweep(listed: Sequence[Job], processes: int, told: Callable[[float], None]) -> list[Outcome]:
    """Carry out all of `listed`, `processes` at a time; `told` how many are done, parts of runs included.

    Ctrl-C ends the runs that are on, leaves out the others, and what is done comes back.

    Raises:
        ProcessLost: a process was killed.
    """
    with Processes(processes) as started:
        return started.carry_out(run_job, listed, lambda parts: told(sum(parts)))


def spreads(outcomes: Sequence[Outcome]) -> dict[str, Spread]:
    """Every number that all completed runs have, by its dotted name; axes are x, y and z."""
    tables = [dict(_numbers("", outcome.numbers)) for outcome in outcomes if outcome.numbers["completed"]]
    found: dict[str, Spread] = {}
    for name in tables[0] if tables else ():
        values = [table[name] for table in tables if name in table]
        if len(values) == len(tables):
            p5, median, p95 = np.round(np.percentile(values, (5.0, 50.0, 95.0)), 5).tolist()
            found[name] = Spread(median, max(values), p5, p95)
    return found


def grouped(outcomes: Sequence[Outcome]) -> Iterator[tuple[Setting, str, list[Outcome]]]:
    """Outcomes of each setting and case, in the order of the jobs."""
    for (setting, case), group in itertools.groupby(outcomes, lambda one: (one.job.setting, one.job.case.name)):
        yield setting, case, list(group)


def sweep_summary(
    experiment: Experiment, listed: Sequence[Job], outcomes: Sequence[Outcome], wall_s: float
) -> dict[str, Any]:
    """All of it as one JSON object; the numbers of each single run are in it too."""
    completed = len(outcomes) == len(listed) and all(outcome.numbers["completed"] for outcome in outcomes)
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "labs": sorted({job.case.lab.title for job in listed}),
        "completed": completed,
        "wall_s": round(wall_s, 3),
        "seeds": sorted({job.seed for job in listed}),
        "planned": len(listed),
        "settings": [
            {
                "setting": dict(setting),
                "case": case,
                "runs": len(group),
                "completed": sum(bool(outcome.numbers["completed"]) for outcome in group),
                "spreads": {name: spread._asdict() for name, spread in spreads(group).items()},
            }
            for setting, case, group in grouped(outcomes)
        ],
        "runs": [
            {
                "setting": dict(outcome.job.setting),
                "case": outcome.job.case.name,
                "seed": outcome.job.seed,
                **outcome.numbers,
            }
            for outcome in outcomes
        ],
    }


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) == 3:
        for axis, inner in zip("xyz", value, strict=True):
            yield from _numbers(f"{name}.{axis}", inner)
    elif isinstance(value, float | int) and not isinstance(value, bool) and name not in NO_RESULTS:
        yield name, float(value)
