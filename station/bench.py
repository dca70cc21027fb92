"""`ctr-station bench`: what this machine achieves, as medians."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table

from core.cosserat import ExactRod
from core.statics import Solution, Statics
from station.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case
from station.robots import load_robot


def model(solves: int = 20_000) -> dict[str, Any]:
    """Warm-started solves while the joints wander about (0, pi/2, -0.100) under 0.2 N along x.

    A solve gives tip, J and C. Joints advance 10 mrad and 0.3 mm between solves, within +-0.5 rad
    and +-15 mm. Accuracy is the distance to the exact rod.
    """
    robot = load_robot("paper").robot()
    statics, exact = Statics(robot), ExactRod(robot)
    wrench = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    centre, reach, stride = (
        np.array([0.0, math.pi / 2, -0.1]),
        np.array([0.5, 0.5, 0.015]),
        np.array([0.01, 0.01, 3e-4]),
    )
    joints, direction = centre.copy(), np.array([1.0, -1.0, 1.0])
    rng = np.random.default_rng(0)
    near: Solution = statics.solve(joints, wrench)
    times, passes, errors = np.empty(solves), np.empty(solves), []
    for index in range(solves):
        # Turn round at the borders and now and then in between, so that the poses differ.
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        direction = np.where(rng.random(3) < 0.01, -direction, direction)
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        joints = joints + direction * stride
        start = time.perf_counter()
        near = statics.solve(joints, wrench, near)
        times[index], passes[index] = time.perf_counter() - start, near.iterations
        if index % max(1, solves // 200) == 0:
            errors.append(float(np.linalg.norm(near.tip - exact.solve(joints, wrench).tip)))
    return {
        "solves": solves,
        "solve_us": {"median": _us(np.median(times)), "p99": _us(np.percentile(times, 99))},
        "passes": round(float(passes.mean()), 3),
        "accuracy_mm": {"mean": round(1e3 * float(np.mean(errors)), 5), "max": round(1e3 * max(errors), 5)},
    }


def headless() -> dict[str, Any]:
    """The feed-forward case of `fig10` in virtual time, after a short warm-up."""
    case = next(case for case in load_experiment("fig10").cases if case.name == "feedforward")

    def shortened(duration: float) -> float:
        file = case.file.model_copy(update={"duration": duration})
        run = run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
        return run.simulated_s / run.wall_s

    shortened(2.0)
    ratios = sorted(shortened(20.0) for _ in range(3))
    return {"times_real_time": round(ratios[1], 2), "min": round(ratios[0], 2), "max": round(ratios[2], 2)}


def table(title: str, result: Mapping[str, Any]) -> Table:
    """A result for reading."""
    shown = Table(title=f"bench {title}", title_style="")
    shown.add_column("figure")
    shown.add_column("value", justify="right")
    for key, value in result.items():
        if isinstance(value, Mapping):
            for part, number in value.items():
                shown.add_row(f"{key} {part}", f"{number}")
        else:
            shown.add_row(key, f"{value}")
    return shown


def _us(seconds: Any) -> float:
    return round(1e6 * float(seconds), 2)
