"""Plan of a sweep: a list of its runs, which the manifest stores so that the same command can continue the sweep."""

import hashlib
import itertools
import re
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from station.config.motions import CsvMotion
from station.config.strict import ConfigError, Row, Strict, read_text
from station.control.bench_calibration import REGISTRATION_FILE, ROBOT_FILE, SENSORS_FILE
from station.experiments.experiment import Case, Experiment, load_experiment
from station.recording.metadata import PACKAGES, versions

#: A text in quotes, or a word such as `dual_layer` that is read as a text without quotes. A key is not such a word.
WORD = re.compile(r"""("(?:\\.|[^"\\])*"|'[^']*')|(?<![\w.+-])([A-Za-z_][\w./-]*+)(?!\s*=)""")
#: Words that are TOML values without quotes.
TOML_WORDS = ("true", "false", "inf", "nan")

#: One combination of values: pairs of a dotted key of an experiment's file and its value, in the order of the options.
Setting = tuple[tuple[str, Any], ...]


def settings(options: Sequence[str]) -> list[Setting]:
    """Return every combination of the values in `key=a,b,c` options; values are TOML, but words need no quotes.

    Raises:
        ConfigError: an option has no key or no value, or two options have the same key.
    """
    choices: list[list[tuple[str, Any]]] = []
    for option in options:
        key, equals, text = option.partition("=")
        key = key.strip()
        values = _values(text if key and equals else "", option)
        if key in [listed[0][0] for listed in choices]:
            raise ConfigError(f"--set {option}: '{key}' is set twice; give all its values in one option")
        choices.append([(key, value) for value in values])
    return list(itertools.product(*choices))


def nested(setting: Setting) -> dict[str, Any]:
    """Return a setting as nested tables of an experiment's file: `controller.k1` becomes `{"controller": {"k1": ...}}`.

    Raises:
        ConfigError: a key is set to a value and is also the parent of another key.
    """
    table: dict[str, Any] = {}
    for key, value in setting:
        at = table
        *parents, last = key.split(".")
        for part in parents:
            at = at.setdefault(part, {})
            if not isinstance(at, dict):
                raise ConfigError(f"--set {key}: '{part}' is set to a value, so it has no keys")
        if last in at:
            raise ConfigError(f"--set {key}: keys below '{key}' are set too; set the table or its keys")
        at[last] = value
    return table


def _values(text: str, option: str) -> list[Any]:
    """Return the values of an option; commas separate them."""
    quoted = WORD.sub(lambda word: word[0] if word[1] or word[2] in TOML_WORDS else f'"{word[2]}"', text)
    try:
        if values := tomllib.loads(f"values = [{quoted}]")["values"]:
            return values
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"--set {option}: '{text}' is not a list of TOML values: {error}; put a text with special characters in"
            " quotes"
        ) from None
    raise ConfigError(f"--set {option}: write KEY=VALUE or KEY=A,B,C, for example controller.k1=1,2.5,5")


class SweepJob(NamedTuple):
    """One run of a sweep."""

    run: int  #: number in the sweep, from 0 on
    setting: Setting
    case: Case
    seed: int


class SweepPlan(Strict):
    """Everything that defines a sweep, apart from its folder."""

    experiment: str
    title: str
    source: str
    """text of the experiment's file"""
    labs: Annotated[tuple[str, ...], Row]
    settings: Annotated[tuple[Mapping[str, Any], ...], Row]
    cases: Annotated[tuple[str, ...], Row]
    seeds: int
    """number of seeds, which are 0 ... seeds - 1"""
    contents: str
    """digest of the cases and of all files that they use: robot, lab, calibration, motion"""
    versions: Mapping[str, str]
    parts: int = 1
    started: float
    """start of the sweep [s] since 1970"""

    @property
    def planned(self) -> int:
        """Number of runs in all parts of the sweep together."""
        return len(self.settings) * len(self.cases) * self.seeds

    def part(self, number: int) -> range:
        """Return the run numbers of one part (1 ... `parts`) of the sweep.

        A part has every N-th run: adjacent runs take similar times, so all parts take about equally long.
        """
        return range(number - 1, self.planned, self.parts)

    def about(self) -> list[tuple[Mapping[str, Any], str, int]]:
        """Return setting, case and seed of every run, by its number."""
        return list(product(self.settings, self.cases, range(self.seeds)))


def jobs(experiment: str, chosen: Sequence[Setting], seeds: Sequence[int], only: str | None = None) -> list[SweepJob]:
    """Return all runs of a sweep, after a complete check of the experiment with every setting.

    Args:
        experiment: preset or file.
        chosen: settings that are applied to every case.
        seeds: seeds of all random numbers in the virtual lab.
        only: name of the only case to run; None: all cases.

    Raises:
        ConfigError: a setting is invalid; the message names file, case, key, value and the expected value.
    """
    listed: list[tuple[Setting, Case, int]] = []
    for setting in chosen:
        cases = load_experiment(experiment, nested(setting), only=only).cases
        listed += [(setting, case, seed) for case in cases for seed in seeds]
    return [SweepJob(number, *one) for number, one in enumerate(listed)]


def plan_of(experiment: Experiment, listed: Sequence[SweepJob], parts: int = 1) -> SweepPlan:
    """Return the plan of all runs of an experiment."""
    found = versions()
    settings = list({repr(job.setting): dict(job.setting) for job in listed}.values())
    return SweepPlan(
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
    """Yield the contents of a case and of its files as texts, without paths: a moved folder has the same contents."""
    file = case.file
    yield case.name
    yield file.model_dump_json(exclude={"robot": True, "lab": True, "calibration": True, "trajectory": {"file"}})
    yield case.robot.model_dump_json()
    yield case.lab.model_dump_json()
    if isinstance(file.trajectory, CsvMotion):
        yield read_text(Path(file.trajectory.file))
    for name in (REGISTRATION_FILE, SENSORS_FILE, ROBOT_FILE) if file.calibration else ():
        path = Path(file.calibration, name)
        yield read_text(path) if path.is_file() else ""
