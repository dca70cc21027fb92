"""Many seeds of one experiment, as it is or with keys of its file set to each of several values.

Every run is a case in virtual time, bit for bit what `run` does with that seed, whoever carries it out: processes
here, or a Dask cluster (`sweep_on_dask.py`).
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.manifest import Row
from station.experiments.results import summarise
from station.experiments.runner import INTERRUPTED, run_case
from station.experiments.side_by_side import Processes, ProcessLost
from station.experiments.sweep_plan import Job, Plan
from station.recording.metadata import versions

#: Of a row: which run it is, and numbers that are the same for all seeds, or the computer's.
NO_RESULTS = ("run", "setting", "case", "seed", "versions", "wall_s", "simulated_s", "counted_from_s")


class Spread(NamedTuple):
    """One number over all seeds."""

    median: float
    worst: float
    p5: float
    p95: float


def run_job(job: Job, progress: Callable[[float], None]) -> Row:
    """One run; one that fails is a row with its reason."""
    try:
        return row_of(job, summarise(run_case(job.case, job.seed, VirtualClock(), progress)))
    except Exception as error:
        return failed(job, f"{type(error).__name__}: {error}")


def row_of(job: Job, numbers: Mapping[str, Any]) -> Row:
    """What is kept of a run that is done."""
    about = {"run": job.run, "setting": dict(job.setting), "case": job.case.name, "seed": job.seed}
    return {**about, "versions": versions(), **numbers}


def failed(job: Job, cause: str) -> Row:
    """What is kept of a run without numbers."""
    return row_of(job, {"completed": False, "cause": cause})


def on_processes(
    listed: Sequence[Job], processes: int, keep: Callable[[Row], None], told: Callable[[float], None]
) -> None:
    """Carry out all of `listed`, so many at a time: `keep` each that is done, `told` how many are, parts included.

    Ctrl-C ends the runs that are on and leaves out the others. Runs whose process is killed are made again, one at a
    time; one that is killed alone, too, is a row with that reason.
    """
    left = {job.run: job for job in listed}

    def kept(row: Row) -> bool:
        if row["cause"] != INTERRUPTED:
            keep(row)
            del left[row["run"]]
        return True

    def carry_out(at: Sequence[Job], most: int) -> None:
        done = len(listed) - len(left)
        with Processes(most) as started:
            started.carry_out(run_job, at, lambda parts: told(done + sum(parts)), kept)

    while left:
        at = list(left.values())
        try:
            carry_out(at, min(processes, len(at)))
            return
        except ProcessLost as lost:
            # A process that ended before it could say what it was about: it was among the first.
            suspected = [at[number] for number in sorted(lost.jobs) if at[number].run in left] or at[:1]
        for job in suspected:
            try:
                carry_out([job], 1)
            except ProcessLost as lost:
                kept(failed(job, str(lost)))
            if job.run in left:
                return  # Ctrl-C


def spreads(rows: Sequence[Row]) -> dict[str, Spread]:
    """Every number that all completed runs have, by its dotted name; axes are x, y and z."""
    tables = [dict(_numbers("", row)) for row in rows if row["completed"]]
    found: dict[str, Spread] = {}
    for name in tables[0] if tables else ():
        values = [table[name] for table in tables if name in table]
        if len(values) == len(tables):
            p5, median, p95 = np.round(np.percentile(values, (5.0, 50.0, 95.0)), 5).tolist()
            found[name] = Spread(median, max(values), p5, p95)
    return found


def grouped(plan: Plan, rows: Sequence[Row]) -> Iterator[tuple[Mapping[str, Any], str, list[Row]]]:
    """Rows of each setting and case, in the order of the plan."""
    about = plan.about()[:: plan.seeds]
    for group, found in itertools.groupby(rows, lambda row: row["run"] // plan.seeds):
        setting, case, _ = about[group]
        yield setting, case, list(found)


def sweep_summary(plan: Plan, rows: Sequence[Row], wall_s: float) -> dict[str, Any]:
    """All of it as one JSON object; `rows` are those that are done, in the order of the plan."""
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
    if name in NO_RESULTS:
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) == 3:
        for axis, inner in zip("xyz", value, strict=True):
            yield from _numbers(f"{name}.{axis}", inner)
    elif isinstance(value, float | int) and not isinstance(value, bool):
        yield name, float(value)
