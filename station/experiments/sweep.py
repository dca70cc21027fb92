"""Sweep: one experiment is run with many seeds, and with several values for the keys of its file.

Every run carries out a case in virtual time. Local processes, a Dask cluster (`dask_cluster.py`) and the command `run`
with the same seed give the same results, bit for bit.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.job_pool import JobPool, ProcessLost
from station.experiments.manifest import Row
from station.experiments.results import summarise
from station.experiments.runner import INTERRUPTED, run_case
from station.experiments.sweep_plan import SweepJob, SweepPlan
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
    """Carry out one run and return its row; the row of a run that fails has the reason."""
    try:
        return row_of(job, summarise(run_case(job.case, job.seed, VirtualClock(), progress)))
    except Exception as error:
        return failed(job, f"{type(error).__name__}: {error}")


def row_of(job: SweepJob, numbers: Mapping[str, Any]) -> Row:
    """Return the row of a finished run: its identity, the package versions and its results."""
    about = {"run": job.run, "setting": dict(job.setting), "case": job.case.name, "seed": job.seed}
    return {**about, "versions": versions(), **numbers}


def failed(job: SweepJob, cause: str) -> Row:
    """Return the row of a run that failed: it has the cause instead of results."""
    return row_of(job, {"completed": False, "cause": cause})


def on_processes(
    listed: Sequence[SweepJob], processes: int, keep: Callable[[Row], None], report_done: Callable[[float], None]
) -> None:
    """Carry out the runs of a sweep in this many processes.

    `keep` receives the row of each finished run; `report_done` receives the number of finished runs, including
    fractions of runs. Ctrl-C ends the active runs, and no further run starts. Runs whose process is killed are repeated
    one at a time. A run whose process is killed again gets a row with that reason.
    """
    left = {job.run: job for job in listed}

    def kept(row: Row) -> bool:
        if row["cause"] != INTERRUPTED:
            keep(row)
            del left[row["run"]]
        return True

    def carry_out(batch: Sequence[SweepJob], max_processes: int) -> None:
        done = len(listed) - len(left)
        with JobPool(max_processes) as pool:
            pool.carry_out(run_job, batch, lambda parts: report_done(done + sum(parts)), kept)

    while left:
        batch = list(left.values())
        try:
            carry_out(batch, min(processes, len(batch)))
            return
        except ProcessLost as lost:
            # A process may end before it reports the number of its job. Then the first job is suspected.
            suspected = [batch[number] for number in sorted(lost.jobs) if batch[number].run in left] or batch[:1]
        for job in suspected:
            try:
                carry_out([job], 1)
            except ProcessLost as lost:
                kept(failed(job, str(lost)))
            if job.run in left:
                return  # Ctrl-C was pressed


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
