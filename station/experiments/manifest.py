"""Manifest of a sweep: a file of JSON lines. The first line is the plan; each further line is a finished run.

A sweep's folder has one manifest, or one for each part of a sweep on many computers. Each line is written as soon as
its run is done. A kill or a full disk may leave an incomplete last line: it is dropped, and its run is repeated.
"""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

from station.config.strict import ConfigError, check
from station.experiments.sweep_plan import SweepPlan
from station.recording.line_store import KeptLines, complete_lines
from station.recording.run_folder import SUMMARY_FILE
from station.recording.run_outcome import RecordingError

MANIFEST_NAME = re.compile(r"manifest(?:-(\d+)-of-(\d+))?\.jsonl")

#: Line of a finished run: keys `run` (its number), `setting`, `case`, `seed`, `versions`, and those of `summarise`.
Row = Mapping[str, Any]


class ManifestEntry(NamedTuple):
    """Content of a manifest file, as `read` returns it."""

    plan: SweepPlan | None  #: plan of the sweep; None if the first line is missing
    rows: dict[int, Row]  #: finished runs by their number
    length: int  #: length of all complete lines [bytes]; the next line is written there


class Manifest:
    """Manifest of the part of a sweep that this process carries out; the file is locked until it is closed."""

    def __init__(self, folder: Path, plan: SweepPlan, part: int = 1) -> None:
        """Create the manifest, or continue an existing one.

        Raises:
            RecordingError: the folder has another sweep, another process carries out this part, or the disk is full.
        """
        self._runs = _Runs(plan, part)
        self.path = folder / manifest_name(part, plan.parts)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            existing = _manifests(folder)
            if not existing and (folder / SUMMARY_FILE).exists():
                raise RecordingError(f"{folder}: the folder has another run; choose another folder")
            for path in existing:
                _refuse_another(path, plan)
            self._file = KeptLines(self.path, "carries this sweep out")
        except OSError as error:
            raise RecordingError(f"{folder}: cannot write results: {error.strerror}") from None
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
        """Close and unlock the manifest."""
        self._file.close()

    def append(self, row: Row) -> None:
        """Store the row of a finished run.

        Raises:
            RecordingError: the run is not in this part, its versions differ, or the disk is full.
        """
        if mismatch := self._runs.mismatch(row):
            raise RecordingError(f"{self.path}: not stored: {mismatch}")
        self.rows[row["run"]] = json.loads(self._file.append(row))


def manifest_name(part: int, parts: int) -> str:
    """Return `manifest.jsonl`, or `manifest-2-of-4.jsonl` for a part."""
    return "manifest.jsonl" if parts == 1 else f"manifest-{part}-of-{parts}.jsonl"


def read_plan(path: Path) -> SweepPlan | None:
    """Return the plan of a manifest; None if its first line is missing or incomplete.

    Raises:
        RecordingError: the manifest cannot be read, or was written by another version of ctr-station.
    """
    with _reading(path) as file:
        first = file.readline()
    try:
        return check(SweepPlan, json.loads(first), str(path)) if first.endswith(b"\n") else None
    except (ValueError, ConfigError) as error:
        raise RecordingError(f"{error}; {path.name} is not a manifest of this version of ctr-station") from None


def read(path: Path) -> ManifestEntry:
    """Return the content of a manifest; an incomplete last line is ignored.

    Raises:
        RecordingError: the manifest cannot be read, or one of its lines is not a run of its plan.
    """
    plan = read_plan(path)
    if plan is None:
        return ManifestEntry(None, {}, 0)
    with _reading(path) as file:
        data = file.read()
    (found, length), runs, rows = complete_lines(path, data), _Runs(plan, _part(path, plan)), dict[int, Row]()
    for number, row in enumerate(found[1:], 2):
        if mismatch := runs.mismatch(row) or ("the run occurs twice" if row["run"] in rows else ""):
            raise RecordingError(f"{path}, line {number}: {mismatch}")
        rows[row["run"]] = row
    return ManifestEntry(plan, rows, length)


def merged(folder: Path) -> tuple[SweepPlan, list[Row]]:
    """Return the plan of a divided sweep and the rows of all its parts in a folder, in the order of the runs.

    Raises:
        RecordingError: a part or a run is missing, is there twice, or belongs to another sweep.
    """
    paths = _manifests(folder)
    plan = next((plan for path in paths if (plan := read_plan(path)) is not None), None)
    if plan is None:
        raise RecordingError(f"{folder}: the folder has no sweep")
    for path in paths:
        _refuse_another(path, plan)
    rows = dict[int, Row]()
    for part in range(1, plan.parts + 1):
        path = folder / manifest_name(part, plan.parts)
        option = f"--part {part}/{plan.parts}" if plan.parts > 1 else "as before"
        if not path.is_file():
            raise RecordingError(f"{path} is missing: carry out the sweep with {option}")
        kept = read(path).rows
        if missing := len(plan.part(part)) - len(kept):
            raise RecordingError(
                f"{path}: {missing} of {len(plan.part(part))} runs are missing; the same command, {option}, continues"
            )
        rows |= kept
    return plan, [rows[number] for number in sorted(rows)]


def folder_of(out: Path, plan: SweepPlan) -> Path:
    """Return the default folder of a sweep: an existing one with the same, unfinished sweep, or else a new one."""
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
    return sorted(path for path in folder.glob("manifest*.jsonl") if MANIFEST_NAME.fullmatch(path.name))


def _refuse_another(path: Path, plan: SweepPlan) -> None:
    kept = read_plan(path)
    if kept is not None and (difference := plan.difference(kept)):
        raise RecordingError(f"{path}: the folder has another sweep: {difference}")


class _Runs:
    """Runs that belong to one part of a sweep; a row is checked against them before it is stored."""

    def __init__(self, plan: SweepPlan, part: int) -> None:
        self._versions = plan.versions
        about = plan.about()
        self._about = {number: about[number] for number in plan.part(part)}

    def mismatch(self, row: Any) -> str:
        """Return the reason why a row does not belong to this part of the sweep; empty if it belongs to it."""
        if not isinstance(row, Mapping) or (number := row.get("run")) not in self._about:
            return "not a run of this part"
        if (row.get("setting"), row.get("case"), row.get("seed")) != self._about[number]:
            return f"run {number} has another setting, case or seed in this sweep"
        if not isinstance(row.get("completed"), bool) or not isinstance(row.get("cause"), str):
            return f"run {number} has no valid outcome ('completed' and 'cause')"
        made = row.get("versions", {})
        for name, version in self._versions.items():
            if made.get(name) != version:
                return f"run {number} was made with {name} {made.get(name)}, but this sweep uses {version}"
        return ""


@contextmanager
def _reading(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


def _part(path: Path, plan: SweepPlan) -> int:
    """Return the number of a manifest's part from its file name."""
    named = MANIFEST_NAME.fullmatch(path.name)
    part, parts = (int(number or 1) for number in named.groups()) if named else (1, 0)
    if parts != plan.parts or not 1 <= part <= parts:
        raise RecordingError(f"{path}: its name has a wrong part number: the sweep has {plan.parts} parts")
    return part
