"""Sweep: one experiment is run with many seeds, and with several values for the keys of its file.

Every run carries out a case in virtual time. Local processes, a Dask cluster (`station/jobs`) and the command `run`
with the same seed give the same results, bit for bit.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.results import summarise
from station.experiments.runner import INTERRUPTED, run_case
from station.experiments.sweep_plan import SweepJob, SweepPlan
from station.jobs.interrupts import JobInterrupted
from station.jobs.manifest import Row
from station.jobs.run_jobs import LOST
from station.recording.metadata import versions

#: Columns of a row for which no statistics are computed: they identify the run, describe the computer, or are equal for
#: all seeds.
NON_RESULT_COLUMNS = ("run", "setting", "case", "seed", "versions", "wall_s", "simulated_s", "counted_from_s")


class SeedStatistics(NamedTuple):
    """Statistics of one result over all seeds: median, worst value, 5th and 95th percentile."""

    median: float
    worst: float
    p5: float
    p95: float


def run_job(job: SweepJob, progress: Callable[[float], None]) -> Row:
    """Carry out one run and return its row; the row of a run that fails has the reason.

    Raises:
        JobInterrupted: Ctrl-C ended the run.
    """
    try:
        recording = run_case(job.case, job.seed, VirtualClock(), progress)
        if recording.cause != INTERRUPTED:
            return _row(job, summarise(recording))
    except Exception as error:
        return _row(job, {"completed": False, "cause": f"{type(error).__name__}: {error}"})
    raise JobInterrupted


def lost_job(job: SweepJob) -> Row:
    """Return the row of a run whose worker process died at every attempt."""
    return _row(job, {"completed": False, "cause": LOST})


def _row(job: SweepJob, numbers: Mapping[str, Any]) -> Row:
    about = {"run": job.run, "setting": dict(job.setting), "case": job.case.name, "seed": job.seed}
    return {**about, "versions": versions(), **numbers}


def spreads(rows: Sequence[Row]) -> dict[str, SeedStatistics]:
    """Return the statistics of every number that all completed runs have, by dotted name, e.g. `rms_error_mm.x`."""
    tables = [dict(_numbers("", row)) for row in rows if row["completed"]]
    found: dict[str, SeedStatistics] = {}
    for name in tables[0] if tables else ():
        values = [table[name] for table in tables if name in table]
        if len(values) == len(tables):
            p5, median, p95 = np.round(np.percentile(values, (5.0, 50.0, 95.0)), 5).tolist()
            found[name] = SeedStatistics(median, max(values), p5, p95)
    return found


def grouped(plan: SweepPlan, rows: Sequence[Row]) -> Iterator[tuple[Mapping[str, Any], str, list[Row]]]:
    """Yield setting, case and rows of each group of runs that differ only in the seed, in the order of the plan."""
    about = plan.about()[:: plan.seeds]
    for group, found in itertools.groupby(rows, lambda row: row["run"] // plan.seeds):
        setting, case, _ = about[group]
        yield setting, case, list(found)


def sweep_summary(plan: SweepPlan, rows: Sequence[Row], wall_s: float) -> dict[str, Any]:
    """Return the results of a sweep as one JSON object; `rows` are the finished runs in the order of the plan."""
    return {
        "experiment": plan.experiment,
        "title": plan.title,
        "labs": list(plan.labs),
        "completed": len(rows) == plan.planned and all(row["completed"] for row in rows),
        "wall_s": round(wall_s, 3),
        "seeds": list(range(plan.seeds)),
        "planned": plan.planned,
        "settings": [
            {
                "setting": dict(setting),
                "case": case,
                "runs": len(group),
                "completed": sum(bool(row["completed"]) for row in group),
                "spreads": {name: spread._asdict() for name, spread in spreads(group).items()},
            }
            for setting, case, group in grouped(plan, rows)
        ],
        "runs": list(rows),
    }


def _numbers(name: str, value: Any) -> Iterator[tuple[str, float]]:
    if name in NON_RESULT_COLUMNS:
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) == 3:
        for axis, inner in zip("xyz", value, strict=True):
            yield from _numbers(f"{name}.{axis}", inner)
    elif isinstance(value, float | int) and not isinstance(value, bool):
        yield name, float(value)
