"""Solve millions of random poses in batches, and compare a sample with the exact rod model.

    python -m tests.tools.many_rows [--rows N] [--sample N] [--seed N] [--near]

The poses cover the travel of the paper's robot, with forces up to 0.6 N in any direction. A solution is wrong if its
tip is further than 0.15 mm from the tip of the exact rod. The exact rod is first solved directly; if the tips differ,
it is loaded from rest in small steps. With `--near` each solution is the initial guess of a pose that is 3 mrad and
0.1 mm away.
"""

import argparse
import json
import sys
import time
from typing import Any

import numpy as np

from core.errors import NoSolution
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.solve_many import solve_many
from tests.measure.accuracy import MAX_COLD_ERROR_M, cases
from tests.measure.batch import random_rows
from tests.measure.solver import Pose, continued_from_rest

#: Number of poses that are solved at once, which limits the memory.
BATCH = 100_000


def checked(rows: int, sample: int, seed: int = 0, near: bool = False) -> dict[str, Any]:
    """Solve `rows` poses and compare `sample` of them with the exact rod; return counts, and distances in mm."""
    robot = cases()["paper"].robot
    model, exact = Statics(robot), ExactRod(robot)
    random = np.random.default_rng(seed)
    chosen = np.sort(random.choice(rows, sample, replace=False))
    failed, spent, wrong, led, distances = 0, 0.0, 0, 0, list[float]()
    for number, first in enumerate(range(0, rows, BATCH)):
        joints, wrenches = random_rows(min(BATCH, rows - first), seed + number)
        begin = time.perf_counter()
        found = solve_many(model, joints, wrenches)
        if near:
            joints = joints + random.choice([-1.0, 1.0], joints.shape) * np.array([3e-3, 3e-3, 1e-4])
            joints[:, 2] = joints[:, 2].clip(-0.13, -0.005)
            found = solve_many(model, joints, wrenches, near=found)
        spent += time.perf_counter() - begin
        failed += len(found.failures)
        for row in (chosen[(chosen >= first) & (chosen < first + BATCH)] - first).tolist():
            if not found.ok[row]:
                continue
            away = _away(exact, found.tip[row], joints[row], wrenches[row])
            if away > MAX_COLD_ERROR_M:
                led += 1
                rod, _ = continued_from_rest(Pose("paper", robot, joints[row], wrenches[row]))
                away = np.inf if rod is None else float(np.linalg.norm(rod.tip - found.tip[row]))
                wrong += away > MAX_COLD_ERROR_M
            distances.append(1e3 * away)
    return {
        "rows": rows, "failed": failed, "rows_per_s": round(rows / spent), "sample": len(distances), "wrong": wrong,
        "led": led, "mean_mm": round(float(np.mean(distances)), 4), "max_mm": round(max(distances), 4),
    }  # fmt: skip


def _away(exact: ExactRod, tip: np.ndarray, joints: np.ndarray, wrench: np.ndarray) -> float:
    try:
        return float(np.linalg.norm(exact.solve(joints, wrench).tip - tip))
    except NoSolution:
        return np.inf


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--sample", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--near", action="store_true")
    given = parser.parse_args()
    result = checked(given.rows, given.sample, given.seed, given.near)
    sys.stdout.write(f"{json.dumps(result)}\n")
    sys.exit(1 if result["failed"] or result["wrong"] else 0)


if __name__ == "__main__":
    main()
