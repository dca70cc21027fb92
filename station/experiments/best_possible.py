"""Best possible tip error under a load: a lower bound that follows from the limits of the stages.

Reports compare the error of a controller with this bound. It is computed for the simulated real robot (plant) without
backlash, friction and delay. A motion is divided into parts at each change of its load, and each part has its own
bound. A part starts with the tip at its setpoint and with joints that do not anticipate the load; from then on the
course of the load is known. Computing a bound takes seconds. So the bounds of an experiment are computed only if the
joints cannot compensate at least one of its loads.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from core.control.trajectories import Setpoint
from core.errors import NoSolution
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.experiments.experiment import Case
from station.experiments.hindsight_bound import LoadCourse, best_path
from station.experiments.load_windows import load_windows, window_name
from station.lab.virtual_bench import virtual_bench

#: Interval between two time samples of a part: this fraction of the time since the load's change, limited to a smallest
#: and a largest interval [s]. The samples are denser where the load has just changed.
RELATIVE_INTERVAL, MIN_INTERVAL_S, MAX_INTERVAL_S = 0.025, 0.010, 0.250
#: Longest time after a change of the load for which a bound is computed [s].
MAX_HORIZON_S = 40.0
#: A step load has its full force at the moment of the step. The force before the step is sampled this much earlier [s].
BEFORE_STEP_S = 1e-6
#: Largest distance between tip and target at which joints count as keeping the tip at the target [m].
HOLDING_TOLERANCE_M = 1e-7


class BoundedCase(NamedTuple):
    """Case whose best possible error is to be computed, with the seed of its lab."""

    case: Case
    seed: int


def has_bound(case: Case) -> bool:
    """Return whether a bound can be computed: the desired tip position is known, and a load at the tip changes."""
    file = case.file
    return (
        file.trajectory.kind not in ("joint_sweep", "follow")
        and bool(file.load.changes)
        and math.isinf(file.load.contact)
    )


def same_bound(case: Case) -> str:
    """Return a text with everything that the bound of a case depends on: cases with equal texts have equal bounds.

    The controller has no influence on the bound.
    """
    file = case.file
    return repr((file.robot, case.lab.plant, case.lab.hidden, file.start, file.trajectory, file.load, file.duration))


def cases_to_bound(cases: Sequence[Case], seed: int) -> dict[str, BoundedCase]:
    """Return one case for each different bound, by the case's text from `same_bound`.

    The result is empty if the joints can compensate every load.
    """
    if not any(case.warnings for case in cases):
        return {}
    return {same_bound(case): BoundedCase(case, seed) for case in cases if has_bound(case)}


def bound(item: BoundedCase, progress: Callable[[float], None]) -> Mapping[str, float | None]:
    """Return a lower bound of the true tip's largest distance from its path [mm], for each part of the motion.

    The value is None for a part of the motion in which the model of the simulated real robot has no solution.
    """
    case, load = item.case, item.case.file.load
    lab = virtual_bench(case.robot, case.lab, item.seed, case.start).lab
    statics, limits = Statics(lab.true_robot, integrator="fourth_order"), case.robot.limits()
    parts = load_windows(load, case.file.duration)
    found: dict[str, float | None] = dict.fromkeys(window_name(start) for start, _ in parts)
    joints = lab.true_joints(case.start)
    try:
        tip = statics.solve(joints, np.zeros(6)).tip
        for number, (start, end) in enumerate(parts, 1):
            times = start + _moments(min(end - start, MAX_HORIZON_S) - BEFORE_STEP_S)
            setpoints = [_setpoint(case, time) for time in times.tolist()]
            course = LoadCourse(
                times,
                tip + np.array([setpoint.position for setpoint in setpoints]),
                np.array([load.force(time) for time in times.tolist()]),
            )
            joints = _holding_joints(statics, limits, joints, course.targets[0], load.force(start - BEFORE_STEP_S))
            jacobian = statics.solve(joints, pure_force(course.forces[0])).jacobian[:3]
            velocity = np.linalg.pinv(jacobian) @ setpoints[0].velocity
            best = best_path(statics, limits, joints, velocity, course)
            found[window_name(start)] = float(np.round(1e3 * best.largest, 4))
            joints = best.joints[-1]
            progress(number / len(parts))
    except NoSolution:
        return found
    return found


def with_bound(numbers: Mapping[str, Any], least: Mapping[str, float | None]) -> dict[str, Any]:
    """Return the numbers of a case with the bound of each part, and the largest of these bounds."""
    parts = {
        name: {**part, "best_possible_mm": least[name]} if name in least else part
        for name, part in numbers.get("by_change", {}).items()
    }
    known = [value for value in least.values() if value is not None]
    if not parts or len(known) < len(least) or not known:
        return dict(numbers)
    return {**numbers, "by_change": parts, "best_possible_mm": max(known)}


def _moments(length: float) -> Array:
    """Return times since a change (m,) up to `length` [s], denser shortly after the change."""
    times = [0.0]
    while times[-1] < length - 0.5 * MIN_INTERVAL_S:
        times.append(min(times[-1] + min(max(RELATIVE_INTERVAL * times[-1], MIN_INTERVAL_S), MAX_INTERVAL_S), length))
    return np.array(times)


def _holding_joints(statics: Statics, limits: Limits, joints: Array, target: Array, force: Array) -> Array:
    """Return joints (n,) in their travel, near `joints`, that keep the tip at a target (3,) [m] under a force [N]."""
    lower, upper = limits.packed[:2]
    inside = np.clip(joints, lower, upper)
    if np.linalg.norm(statics.solve(inside, pure_force(force)).tip - target) < HOLDING_TOLERANCE_M:
        return inside
    found = least_squares(
        lambda q: 1e3 * (statics.solve(q, pure_force(force)).tip - target),
        inside,
        bounds=(lower, upper),
        x_scale=limits.speed,
    )
    return found.x


def _setpoint(case: Case, time: float) -> Setpoint:
    """Return the setpoint of the tip relative to the tip at the start."""
    order = case.orders.at(time)
    assert isinstance(order, Setpoint), "swept joints have no bound"  # noqa: S101
    return order
