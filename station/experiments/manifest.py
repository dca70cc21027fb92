"""The manifests in a sweep's folder: the plan as the first line, then a line of JSON for each run that is done.

There is one, or one for each part of a sweep that many computers share. A line is written whole, and at once; what is
left of one that was not (kill -9, a full disk) is dropped, and its run is made again.
"""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

from station.config.strict import ConfigError, check
from station.experiments.sweep_plan import Plan
from station.recording.kept_lines import KeptLines, whole_lines
from station.recording.label import RecordingError
from station.recording.run_folder import SUMMARY

NAME = re.compile(r"manifest(?:-(\d+)-of-(\d+))?\.jsonl")

#: A run that is done: `run` (its number), `setting`, `case`, `seed`, `versions`, and the numbers of `summarise`.
Row = Mapping[str, Any]


class Kept(NamedTuple):
    """What a manifest has."""

    plan: Plan | None  #: None: not even a first line
    rows: dict[int, Row]  #: by the run's number
    length: int  #: of its whole lines [bytes]


class Manifest:
    """A part of a sweep that is being carried out; its manifest is locked until it is closed."""

    def __init__(self, folder: Path, plan: Plan, part: int = 1) -> None:
        """Begin it, or go on with it.

        Raises:
            RecordingError: another sweep is kept there, somebody else carries it out, or the disk does not take it.
        """
        self._runs = _Runs(plan, part)
        self.path = folder / manifest_name(part, plan.parts)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            there = _manifests(folder)
            if not there and (folder / SUMMARY).exists():
                raise RecordingError(f"{folder}: there is another run; choose another folder")
            for path in there:
                _refuse_another(path, plan)
            self._file = KeptLines(self.path, "carries this sweep out")
        except OSError as error:
            raise RecordingError(f"{folder}: cannot write results there: {error.strerror}") from None
        try:
            _refuse_another(self.path, plan)
            kept = read(self.path)
            self.plan, self.rows, self._file.length = kept.plan or plan, kept.rows, kept.length
            if kept.plan is None:
                self._file.append(plan.model_dump())
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let others have it."""
        self._file.close()

    def append(self, row: Row) -> None:
        """Keep a run that is done.

        Raises:
            RecordingError: it is none of this part, was made by other versions, or the disk does not take it.
        """
        if wrong := self._runs.wrong(row):
            raise RecordingError(f"{self.path}: not kept: {wrong}")
        self.rows[row["run"]] = json.loads(self._file.append(row))


def manifest_name(part: int, parts: int) -> str:
    """`manifest.jsonl`, or `manifest-2-of-4.jsonl`."""
    return "manifest.jsonl" if parts == 1 else f"manifest-{part}-of-{parts}.jsonl"


def read_plan(path: Path) -> Plan | None:
    """The plan that a manifest is of; None: not even that was written.

    Raises:
        RecordingError: it cannot be read, or is of another version.
    """
    with _reading(path) as file:
        first = file.readline()
    try:
        return check(Plan, json.loads(first), str(path)) if first.endswith(b"\n") else None
    except (ValueError, ConfigError) as error:
        raise RecordingError(f"{error}; {path.name} is no manifest of this version of ctr-station") from None


def read(path: Path) -> Kept:
    """What is kept in a manifest; half a line at its end counts as none.

    Raises:
        RecordingError: it cannot be read, or a line is no run of its plan.
    """
    plan = read_plan(path)
    if plan is None:
        return Kept(None, {}, 0)
    with _reading(path) as file:
        data = file.read()
    (found, length), runs, rows = whole_lines(path, data), _Runs(plan, _part(path, plan)), dict[int, Row]()
    for number, row in enumerate(found[1:], 2):
        if wrong := runs.wrong(row) or ("the run is there twice" if row["run"] in rows else ""):
            raise RecordingError(f"{path}, line {number}: {wrong}")
        rows[row["run"]] = row
    return Kept(plan, rows, length)


def merged(folder: Path) -> tuple[Plan, list[Row]]:
    """All runs of the parts in a folder, in their order.

    Raises:
        RecordingError: a part or a run is missing, twice or of another sweep.
    """
    paths = _manifests(folder)
    plan = next((plan for path in paths if (plan := read_plan(path)) is not None), None)
    if plan is None:
        raise RecordingError(f"{folder}: no sweep is kept there")
    for path in paths:
        _refuse_another(path, plan)
    rows = dict[int, Row]()
    for part in range(1, plan.parts + 1):
        path = folder / manifest_name(part, plan.parts)
        option = f"--part {part}/{plan.parts}" if plan.parts > 1 else "as before"
        if not path.is_file():
            raise RecordingError(f"{path} is missing: carry out the sweep with {option}")
        kept = read(path).rows
        if lacking := len(plan.part(part)) - len(kept):
            raise RecordingError(
                f"{path}: {lacking} of {len(plan.part(part))} runs are missing; the same command, {option}, goes on"
            )
        rows |= kept
    return plan, [rows[number] for number in sorted(rows)]


def folder_of(out: Path, plan: Plan) -> Path:
    """Where a sweep goes that was told no folder of its own: on with the same one if that is not done, or a new one."""
    for folder in sorted(out.glob(f"sweep-{plan.experiment}-*"), reverse=True):
        with suppress(RecordingError):
            path = folder / manifest_name(1, 1)
            kept = read_plan(path) if path.is_file() else None
            if kept is not None and not plan.difference(kept) and len(read(path).rows) < plan.planned:
                return folder
    name = f"sweep-{plan.experiment}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    number = 1
    while (folder := out / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def _manifests(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("manifest*.jsonl") if NAME.fullmatch(path.name))


def _refuse_another(path: Path, plan: Plan) -> None:
    kept = read_plan(path)
    if kept is not None and (difference := plan.difference(kept)):
        raise RecordingError(f"{path}: another sweep is kept there: {difference}")


class _Runs:
    """The runs of a part, to hold rows against."""

    def __init__(self, plan: Plan, part: int) -> None:
        self._versions = plan.versions
        about = plan.about()
        self._about = {number: about[number] for number in plan.part(part)}

    def wrong(self, row: Any) -> str:
        """What makes it none of them; empty when it is one."""
        if not isinstance(row, Mapping) or (number := row.get("run")) not in self._about:
            return "no run of this part"
        if (row.get("setting"), row.get("case"), row.get("seed")) != self._about[number]:
            return f"run {number} has another setting, case or seed in this sweep"
        if not isinstance(row.get("completed"), bool) or not isinstance(row.get("cause"), str):
            return f"run {number} does not say how it ended"
        made = row.get("versions", {})
        for name, version in self._versions.items():
            if made.get(name) != version:
                return f"run {number} was made with {name} {made.get(name)}, this sweep with {version}"
        return ""


@contextmanager
def _reading(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


def _part(path: Path, plan: Plan) -> int:
    """The part that a manifest is of, by its name."""
    named = NAME.fullmatch(path.name)
    part, parts = (int(number or 1) for number in named.groups()) if named else (1, 0)
    if parts != plan.parts or not 1 <= part <= parts:
        raise RecordingError(f"{path}: is not named as it was: the sweep in it has {plan.parts} parts")
    return part
