"""Measure the stiffness of the tip in the cases of the experiment `stiffness` that push with a force.

`python -m tests.tools.stiffness_runs LAB [CASE ...] [--seeds 10] [--calibrated]`

The output is one line per case: the force over the desired stiffness, divided by the true displacement from 17 to 20 s
after the start, for each seed. With `--calibrated` the bench of each seed is first calibrated by itself.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case
from tests.tools.touch_runs import calibrated

FROM_S = 17.0
CASES = tuple(f"{stiffness}-{axis}" for stiffness in ("half", "natural", "triple") for axis in "xyz")


def measured(name: str, lab: str, seed: int, calibration: str) -> float:
    """Return force over desired stiffness over true displacement of a case; NaN if the motion ended early."""
    case = load_experiment("stiffness", {"lab": lab, "calibration": calibration}, only=name).cases[0]
    run = run_case(case, seed, VirtualClock(), lambda _: None)
    if not run.completed or case.controller.stiffness is None:
        return np.nan
    of, axis = run.channels.of, "xyz".index(name[-1])
    late = of(run.rows, "time")[:, 0] > FROM_S
    given_way = of(run.rows, "tip_true")[late, axis].mean() - of(run.rows, "tip_true")[0, axis]
    force = of(run.rows, "force_true")[late, axis].mean()
    return float(force / case.controller.stiffness.axes[axis] / given_way)


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the stiffness of the tip.")
    parser.add_argument("lab", choices=("gentle", "realistic"))
    parser.add_argument("case", nargs="*", choices=[*CASES, []], default=CASES)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--calibrated", action="store_true", help="calibrate the bench of each seed first")
    wanted = parser.parse_args()
    with ProcessPoolExecutor() as pool, tempfile.TemporaryDirectory() as where:
        seeds, folders = range(wanted.seeds), [""] * wanted.seeds
        if wanted.calibrated:
            own = [str(Path(where, str(seed))) for seed in seeds]
            folders = list(pool.map(calibrated, own, [wanted.lab] * wanted.seeds, seeds))
        for name in wanted.case:
            found = list(pool.map(measured, [name] * len(seeds), [wanted.lab] * len(seeds), seeds, folders))
            each = " ".join(f"{one:.2f}" for one in found)
            print(f"{name}: {min(found):.2f} to {max(found):.2f} ({each})", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
