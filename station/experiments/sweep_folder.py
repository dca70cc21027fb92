"""Folder of a sweep: it has one manifest, or one for each part of a sweep on many computers."""

import os
import re
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from station.config.strict import ConfigError, check
from station.experiments.sweep_plan import SweepPlan
from station.jobs.manifest import Manifest, Row, difference, read, read_plan, refuse_another
from station.recording.history import SWEEP_FILE
from station.recording.run_folder import EXPERIMENT_FILE, REPORT_FILE, SUMMARY_FILE
from station.recording.run_outcome import RecordingError
from station.regular_file import is_regular

#: Files that a sweep writes next to its manifest, or that a run has.
RESULT_FILES = (SUMMARY_FILE, EXPERIMENT_FILE, SWEEP_FILE, REPORT_FILE)
MANIFEST_NAME = re.compile(r"manifest(?:-\d+-of-\d+)?\.jsonl")


def sweep_manifest(folder: Path, plan: SweepPlan, part: int = 1) -> Manifest[int]:
    """Create the manifest of a part of a sweep, or continue an existing one; its keys are the numbers of the runs.

    Raises:
        RecordingError: the folder has another sweep, another process carries out this part, or the disk is full.
    """
    existing, about = _manifests(folder), plan.model_dump()
    for name in () if existing else RESULT_FILES:
        if os.path.lexists(folder / name):  # of a run or of the user
            raise RecordingError(f"{folder}: the folder has another {name}; choose another folder for the sweep")
    for path in existing:
        refuse_another(path, read_plan(path), about)
    return Manifest(folder / manifest_name(part, plan.parts), about, run_number(plan, part))


def manifest_name(part: int, parts: int) -> str:
    """Return `manifest.jsonl`, or `manifest-2-of-4.jsonl` for a part."""
    return "manifest.jsonl" if parts == 1 else f"manifest-{part}-of-{parts}.jsonl"


def run_number(plan: SweepPlan, part: int) -> Callable[[Row], int]:
    """Return a function that checks whether a row belongs to this part of the sweep, and returns its run's number.

    A row has the keys `run` (its number), `setting`, `case`, `seed`, `versions`, and those of `summarise`.
    """
    runs, about = plan.part(part), plan.about()

    def check_row(row: Row) -> int:
        run: int = row.get("run", -1)
        if run not in runs:
            raise ValueError("not a run of this part")
        if (row.get("setting"), row.get("case"), row.get("seed")) != about[run]:
            raise ValueError(f"run {run} differs in setting, case or seed from that run of this sweep")
        if not isinstance(row.get("completed"), bool) or not isinstance(row.get("cause"), str):
            raise ValueError(f"run {run} has no valid outcome ('completed' and 'cause')")
        found = row.get("versions", {})
        for name, version in plan.versions.items():
            if found.get(name) != version:
                raise ValueError(f"run {run} was made with {name} {found.get(name)}, but this sweep uses {version}")
        return run

    return check_row


def merged(folder: Path) -> tuple[SweepPlan, list[Row]]:
    """Return the plan of a divided sweep and the rows of all its parts in a folder, in the order of the runs.

    Raises:
        RecordingError: a part or a run is missing, exists twice, or belongs to another sweep.
    """
    plans = {path: found for path in _manifests(folder) if (found := read_plan(path)) is not None}
    if not plans:
        raise RecordingError(f"{folder}: the folder has no sweep")
    first, stored = next(iter(plans.items()))
    try:
        plan = check(SweepPlan, stored, str(first))
    except ConfigError as error:
        raise RecordingError(f"{error}; {first.name} is not a manifest of this version of ctr-station") from None
    for path, found in plans.items():
        refuse_another(path, found, stored)
    rows = dict[int, Row]()
    for part in range(1, plan.parts + 1):
        path = folder / manifest_name(part, plan.parts)
        option = f"--part {part}/{plan.parts}" if plan.parts > 1 else "the same options"
        if not path.is_file():
            raise RecordingError(f"{path} is missing: carry out the sweep with {option}")
        _, found, _ = read(path, run_number(plan, part))
        if missing := len(plan.part(part)) - len(found):
            raise RecordingError(
                f"{path}: {missing} of {len(plan.part(part))} runs are missing; repeat the command with {option}"
            )
        rows |= found
    return plan, [rows[number] for number in sorted(rows)]


def folder_of(out: Path, plan: SweepPlan) -> Path:
    """Return the default folder of a sweep: an existing one with the same, unfinished sweep, or else a new one."""
    check_row = run_number(plan, 1)
    found = out.glob(f"sweep-{plan.experiment}-*/{manifest_name(1, 1)}")
    for path in sorted(filter(is_regular, found), reverse=True):
        with suppress(RecordingError):
            if difference(read_plan(path), plan.model_dump()) == "" and len(read(path, check_row)[1]) < plan.planned:
                return path.parent
    name = f"sweep-{plan.experiment}-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    number = 1
    while (folder := out / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def _manifests(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("manifest*.jsonl") if MANIFEST_NAME.fullmatch(path.name))
