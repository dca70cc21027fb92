"""`ctr-station bench model`: computing time and accuracy of the loaded model, solved while the joints move."""

import math
import time
from typing import Any

import numpy as np

from core.model.cosserat import ExactRod
from core.model.statics import Solution, Statics
from station.config.robots import load_robot


def model(solves: int = 20_000) -> dict[str, Any]:
    """Measure warm-started solves while the joints move around (0, pi/2, -0.100) under 0.2 N along x.

    The timed part solves the model and reads tip, J and C. Between two solves the joints move by 10 mrad and 0.3 mm,
    within +-0.5 rad and +-15 mm. `accuracy_mm` is the distance of the tip from that of the exact rod. `residual` is
    computed separately after the solve. For `derivative_error` the model is solved again from the solution; the error
    is the difference of both J and C, relative to the largest entry. The result also has the same numbers for the
    fourth-order integrator, and the time of a pass along the tubes with and without derivatives.
    """
    robot = load_robot("paper").robot()
    result = _wander(Statics(robot), solves)
    result["state_only_us"], result["pass_us"], sublinks = _passes(Statics(robot))
    result["sublinks"] = sublinks
    result["per_sublink_us"] = {
        "state": round(result["state_only_us"] / sublinks, 4),
        "derivatives": round((result["pass_us"] - result["state_only_us"]) / sublinks, 4),
    }
    result["fourth_order"] = _wander(Statics(robot, integrator="fourth_order"), solves)
    return result


def _wander(statics: Statics, solves: int) -> dict[str, Any]:
    exact = ExactRod(statics.robot)
    wrench = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    centre, reach, stride = (
        np.array([0.0, math.pi / 2, -0.1]),
        np.array([0.5, 0.5, 0.015]),
        np.array([0.01, 0.01, 3e-4]),
    )
    joints, direction = centre.copy(), np.array([1.0, -1.0, 1.0])
    rng = np.random.default_rng(0)
    near: Solution = statics.solve(joints, wrench)
    times, passes, checked = np.empty(solves), np.empty(solves), list[tuple[float, float, float]]()
    for index in range(solves):
        # A joint reverses at the border of its range, and also at random, so that the poses differ.
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        direction = np.where(rng.random(3) < 0.01, -direction, direction)
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        joints = joints + direction * stride
        start = time.perf_counter()
        near = statics.solve(joints, wrench, near)
        tip, jacobian, compliance = near.tip, near.jacobian, near.compliance
        times[index], passes[index] = time.perf_counter() - start, near.iterations
        if index % max(1, solves // 200) == 0:
            again = statics.solve(joints, wrench, near)
            differences = [
                float(np.abs(found - better).max() / np.abs(better).max())
                for found, better in (
                    (jacobian[:3], again.jacobian[:3]),
                    (compliance[:3, :3], again.compliance[:3, :3]),
                )
            ]
            error = float(np.linalg.norm(tip - exact.solve(joints, wrench).tip))
            checked.append((error, statics.residual(near), max(differences)))
    errors, residuals, derivative_errors = zip(*checked, strict=True)
    return {
        "solves": solves,
        "solve_us": {"median": _microseconds(np.median(times)), "p99": _microseconds(np.percentile(times, 99))},
        "passes": round(float(passes.mean()), 3),
        "accuracy_mm": {"mean": round(1e3 * float(np.mean(errors)), 5), "max": round(1e3 * max(errors), 5)},
        "residual": float(f"{max(residuals):.2g}"),
        "derivative_error": float(f"{max(derivative_errors):.2g}"),
    }


def _passes(statics: Statics) -> tuple[float, float, int]:
    """Return the median times of a pass without and with derivatives [us], and the number of sub-links."""
    solution = statics.solve(np.array([0.0, math.pi / 2, -0.1]), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    durations: list[float] = []
    for with_derivatives in (False, True):
        times = np.empty(100)
        for index in range(times.size):
            start = time.perf_counter()
            statics.repeat_pass(solution, 100, with_derivatives)
            times[index] = (time.perf_counter() - start) / 100
        durations.append(_microseconds(np.median(times[3:])))
    return durations[0], durations[1], statics.shape(solution).shape[0] - 1


def _microseconds(seconds: Any) -> float:
    return round(1e6 * float(seconds), 2)
