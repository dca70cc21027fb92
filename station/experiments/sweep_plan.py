"""What a sweep is: its runs, and what a manifest keeps of the command, so that the same command is known again."""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from station.config.motions import CsvMotion
from station.config.strict import ConfigError, Row, Strict, read_text
from station.control.known_calibration import REGISTRATION, ROBOT, SENSORS
from station.experiments.experiment import Case, Experiment, load_experiment
from station.experiments.sweep_settings import Setting, nested
from station.recording.metadata import PACKAGES, versions

#: Where the folders of sweeps differ, in the order in which it is told; of the others the values say nothing.
DIFFERENCES = {
    "experiment": "the experiment",
    "parts": "the number of parts",
    "settings": "--set (and --lab)",
    "cases": "the cases",
    "seeds": "--seeds",
    "versions": "the versions",
}
CHANGED = {
    "source": "the experiment's file has changed since",
    "contents": "a robot, lab, calibration or motion that the experiment names has changed since",
}
#: So much of a difference is told [characters].
LONGEST = 200


class Job(NamedTuple):
    """One run of a sweep."""

    run: int  #: its number in the sweep, from 0 on
    setting: Setting
    case: Case
    seed: int


class Plan(Strict):
    """All that a sweep is made of, without the place where it is."""

    experiment: str
    title: str
    source: str
    """the experiment's file"""
    labs: Annotated[tuple[str, ...], Row]
    settings: Annotated[tuple[Mapping[str, Any], ...], Row]
    cases: Annotated[tuple[str, ...], Row]
    seeds: int
    """0 ... seeds - 1"""
    contents: str
    """digest of the cases with everything that they take from other files"""
    versions: Mapping[str, str]
    parts: int = 1
    started: float
    """[s] since 1970"""

    @property
    def planned(self) -> int:
        """Number of runs, of all parts together."""
        return len(self.settings) * len(self.cases) * self.seeds

    def part(self, number: int) -> range:
        """Numbers of the runs of a part, 1 ... parts: neighbours, which take as long as each other, are shared out."""
        return range(number - 1, self.planned, self.parts)

    def about(self) -> list[tuple[Mapping[str, Any], str, int]]:
        """Setting, case and seed of every run, by its number."""
        return list(product(self.settings, self.cases, range(self.seeds)))

    def difference(self, kept: "Plan") -> str:
        """Where another plan is not this one; empty when they are the same."""
        for name, words in DIFFERENCES.items():
            there, here = (json.dumps(plan.model_dump()[name]) for plan in (kept, self))
            if there != here:
                return f"{words}: {there[:LONGEST]} there, {here[:LONGEST]} here"
        return next((words for name, words in CHANGED.items() if getattr(kept, name) != getattr(self, name)), "")


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
    listed: list[tuple[Setting, Case, int]] = []
    for setting in chosen:
        cases = load_experiment(experiment, nested(setting)).cases
        if only is not None and only not in [case.name for case in cases]:
            raise ConfigError(f"--case {only}: the cases are {', '.join(case.name for case in cases)}")
        listed += [(setting, case, seed) for case in cases if only in (None, case.name) for seed in seeds]
    return [Job(number, *one) for number, one in enumerate(listed)]


def plan_of(experiment: Experiment, listed: Sequence[Job], parts: int = 1) -> Plan:
    """The plan of all runs of an experiment."""
    found = versions()
    settings = list({repr(job.setting): dict(job.setting) for job in listed}.values())
    return Plan(
        experiment=experiment.name,
        title=experiment.title,
        source=experiment.source,
        labs=tuple(sorted({job.case.lab.title for job in listed})),
        settings=tuple(settings),
        cases=tuple(dict.fromkeys(job.case.name for job in listed)),
        seeds=len({job.seed for job in listed}),
        contents=_digest(job.case for job in listed if job.seed == 0),
        versions={name: found[name] for name in PACKAGES},
        parts=parts,
        started=time.time(),
    )


def _digest(cases: Iterator[Case]) -> str:
    found = hashlib.sha256()
    for case in cases:
        for part in _contents(case):
            found.update(part.encode() + b"\0")
    return found.hexdigest()


def _contents(case: Case) -> Iterator[str]:
    """What a case is made of, wherever its files lie."""
    file = case.file
    yield case.name
    yield file.model_dump_json(exclude={"robot": True, "lab": True, "calibration": True, "trajectory": {"file"}})
    yield case.robot.model_dump_json()
    yield case.lab.model_dump_json()
    if isinstance(file.trajectory, CsvMotion):
        yield read_text(Path(file.trajectory.file))
    for name in (REGISTRATION, SENSORS, ROBOT) if file.calibration else ():
        path = Path(file.calibration, name)
        yield read_text(path) if path.is_file() else ""
