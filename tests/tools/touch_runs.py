"""Measure how well the tip holds a force, for seeds of the lab, compared with the best possible on moving walls.

`python -m tests.tools.touch_runs LAB [CASE ...] [--seeds 10] [--calibrated]`

LAB is `gentle` or `realistic`; CASE is a case of the experiment `touch`. The output is one line per run: mean and RMS
error of the true force [mN], largest force [N], share of the time without contact [%], and RMS error of the tip across
the direction [mm], from 6 s after the start. For a wall that moves, a line has the errors [mN] that no controller can
avoid: it knows the wall in advance, and has only the joints' speed and acceleration as limits. With `--calibrated` the
bench of each seed is first calibrated by itself.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from core.model.solution import pure_force
from core.model.statics import Statics
from station.control.clock import VirtualClock
from station.experiments.best_possible import LoadCourse, best_path
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import run_case
from tests.tools.calibrated_runs import write

#: Time after which errors count, also of the best possible [s].
FROM_S, BOUND_FROM_S, BOUND_UNTIL_S = 6.0, 1.0, 3.0
CASES = ("wall", "soft", "axial", "moving", "fast", "circle")


class Run(NamedTuple):
    """One run: the case's name, the lab, the seed, and the folder of its calibration (empty: uncalibrated)."""

    case: str
    lab: str
    seed: int
    calibration: str = ""


def chosen(run: Run) -> Case:
    """Return the case of a run."""
    return load_experiment("touch", {"lab": run.lab, "calibration": run.calibration}, only=run.case).cases[0]


def calibrated(folder: str, lab: str, seed: int) -> str:
    """Calibrate the bench of a seed; return the folder of the calibration."""
    Path(folder).mkdir()
    write(Path(folder), lab, seed)
    return folder


def measured(run: Run) -> str:
    """Return a line with the errors of a run."""
    case = chosen(run)
    recording = run_case(case, run.seed, VirtualClock(), lambda _: None)
    of, rows = recording.channels.of, recording.rows
    late = of(rows, "time")[:, 0] > FROM_S
    along = np.array(case.file.trajectory.direction, float) / np.linalg.norm(case.file.trajectory.direction)
    force = -of(rows, "force_true") @ along
    apart = (of(rows, "tip_true") - of(rows, "tip_desired"))[late]
    across = apart - np.outer(apart @ along, along)
    error = 1e3 * (force[late] - case.file.trajectory.force)
    return (
        f"{run.lab} {run.case} {run.seed}: mean {error.mean():.1f}, RMS {np.sqrt((error**2).mean()):.1f} mN,"
        f" largest {force.max():.2f} N, without contact {1e2 * (force[late] < 1e-3).mean():.1f} %,"
        f" across {1e3 * np.sqrt((across**2).sum(axis=1).mean()):.2f} mm" + ("" if recording.completed else " (ended)")
    )


def best(run: Run) -> str:
    """Return a line with the smallest possible errors of the force on a wall that moves."""
    case = chosen(run)
    load, along = case.file.load, np.array(case.file.trajectory.direction, float)
    statics = Statics(case.robot.robot(), integrator="fourth_order")
    times = np.arange(0.0, BOUND_UNTIL_S, 0.04)
    force = -case.file.trajectory.force * along
    rest = statics.solve(case.start, pure_force(force))
    wall = load.amplitude * np.sin(2.0 * np.pi * load.frequency * times)
    course = LoadCourse(times, rest.tip + np.outer(wall, along), np.tile(force, (len(times), 1)))
    stiffness = 1.0 / (along @ rest.compliance[:3, :3] @ along + 1.0 / load.stiffness)
    errors = best_path(statics, case.robot.limits(), case.start, np.zeros(len(case.start)), course).errors @ along
    late = times > BOUND_FROM_S
    possible, at_rest = (1e3 * stiffness * np.sqrt((each[late] ** 2).mean()) for each in (errors, wall))
    return f"{run.case}: best possible RMS {possible:.1f} mN; joints at rest {at_rest:.1f} mN"


def main() -> None:
    """Print a line for each run, and one for each wall that moves."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lab", choices=("gentle", "realistic"))
    parser.add_argument("case", nargs="*", default=CASES)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--calibrated", action="store_true", help="calibrate the bench of each seed first")
    wanted = parser.parse_args()
    for name in wanted.case:
        if chosen(Run(name, wanted.lab, 0)).file.load.amplitude:
            print(best(Run(name, wanted.lab, 0)), flush=True)  # noqa: T201
    with ProcessPoolExecutor() as pool, tempfile.TemporaryDirectory() as where:
        seeds, folders = range(wanted.seeds), [""] * wanted.seeds
        if wanted.calibrated:
            own = [str(Path(where, str(seed))) for seed in seeds]
            folders = list(pool.map(calibrated, own, [wanted.lab] * wanted.seeds, seeds))
        runs = [Run(name, wanted.lab, seed, folders[seed]) for name in wanted.case for seed in seeds]
        for line in pool.map(measured, runs):
            print(line, flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
