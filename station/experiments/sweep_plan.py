"""Plan of a sweep: a list of its runs, which the manifest stores so that the same command can continue the sweep."""

import hashlib
import itertools
import json
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

#: Value that is read as a text although it has no quotes, such as `dual_layer`.
BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")

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
        if not key or not equals or not text.strip():
            raise ConfigError(f"--set {option}: write KEY=VALUE or KEY=A,B,C, for example controller.k1=1,2.5,5")
        if key in [listed[0][0] for listed in choices]:
            raise ConfigError(f"--set {option}: '{key}' is set twice; give all its values in one option")
        choices.append([(key, _value(part, option)) for part in _parts(text)])
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


def _parts(text: str) -> Iterator[str]:
    """Split a text at its commas outside brackets and quotes."""
    depth, quote, first = 0, "", 0
    for at, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
        elif character == "," and depth == 0:
            yield text[first:at].strip()
            first = at + 1
    yield text[first:].strip()


def _value(text: str, option: str) -> Any:
    if not text:
        raise ConfigError(f"--set {option}: a value is missing between the commas")
    if BARE_WORD.fullmatch(text) and text not in ("true", "false", "inf", "nan"):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"--set {option}: '{text}' is not a TOML value: {error}; put a text with special characters in quotes"
        ) from None


#: Fields of a plan in the order in which two plans are compared, each with a label. A message about a difference shows
#: the values of both plans.
DIFFERENCE_LABELS = {
    "experiment": "the experiment",
    "parts": "the number of parts",
    "settings": "--set (and --lab)",
    "cases": "the cases",
    "seeds": "--seeds",
    "versions": "the versions",
}
#: Messages about a difference in those fields of a plan whose values would not help the user (texts and digests).
CHANGE_MESSAGES = {
    "source": "the experiment's file has changed since",
    "contents": "a robot, lab, calibration or motion that the experiment names has changed since",
}
#: Length to which a value is cut in the message about a difference between two plans [characters].
MAX_DIFFERENCE_CHARS = 200


class SweepJob(NamedTuple):
    """One run of a sweep."""

    run: int  #: number in the sweep, from 0 on
    setting: Setting
    case: Case
    seed: int


class SweepPlan(Strict):
    """Everything that defines a sweep, apart from its folder; two equal plans are the same sweep."""

    experiment: str
    title: str
    source: str
    """text of the experiment's file"""
    labs: Annotated[tuple[str, ...], Row]
    settings: Annotated[tuple[Mapping[str, Any], ...], Row]
    cases: Annotated[tuple[str, ...], Row]
    seeds: int
    """0 ... seeds - 1"""
    contents: str
    """digest of the cases and of all files that they use"""
    versions: Mapping[str, str]
    parts: int = 1
    started: float
    """[s] since 1970"""

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

    def difference(self, kept: "SweepPlan") -> str:
        """Return a text about the first difference between a stored plan and this one; empty if they are equal."""
        for name, label in DIFFERENCE_LABELS.items():
            stored, requested = (json.dumps(plan.model_dump()[name]) for plan in (kept, self))
            if stored != requested:
                return f"{label}: {stored[:MAX_DIFFERENCE_CHARS]} stored, {requested[:MAX_DIFFERENCE_CHARS]} requested"
        return next(
            (message for name, message in CHANGE_MESSAGES.items() if getattr(kept, name) != getattr(self, name)), ""
        )


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
