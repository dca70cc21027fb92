"""What stages of these speeds could do at best against a load, beside what a controller did.

The bound is computed on the lab's true robot (without play, friction and delay), once for each load and for each
of the parts between its changes: at first the tip is where it should be and no joint has moved on account of what
comes, from then on the load's course is known. It is worth the seconds where one of an experiment's loads is more
than the joints can make up for; then all of them are bounded.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from core.control.best_path import Course, best_path
from core.control.trajectories import Setpoint
from core.errors import NoSolution
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.experiments.changes import window_name, windows
from station.experiments.experiment import Case
from station.lab.virtual_bench import virtual_bench

#: Moments are this part of the time since the change apart, between these bounds [s].
APART, CLOSEST, WIDEST = 0.025, 0.010, 0.250
#: A bound looks no farther than this behind a change [s].
LONGEST = 40.0
#: A load at once is there at its first moment; right before it there is none [s].
BEFORE = 1e-6
#: Joints hold the tip when it is so near to its target [m].
AT = 1e-7


class Bounded(NamedTuple):
    """A case whose bound is to be computed, and the seed of its lab."""

    case: Case
    seed: int


def has_bound(case: Case) -> bool:
    """Whether the tip is meant to be somewhere, whoever controls it, while a load acts on it."""
    file = case.file
    return (
        file.trajectory.kind not in ("joint_sweep", "follow")
        and bool(file.load.changes)
        and math.isinf(file.load.contact)
    )


def same_bound(case: Case) -> str:
    """What the bound of a case depends on, whoever controls it."""
    file = case.file
    return repr((file.robot, case.lab.plant, case.lab.hidden, file.start, file.trajectory, file.load, file.duration))


def to_bound(cases: Sequence[Case], seed: int) -> dict[str, Bounded]:
    """One case for each bound, by what it depends on; none where no load is more than the joints can make up for."""
    if not any(case.warnings for case in cases):
        return {}
    return {same_bound(case): Bounded(case, seed) for case in cases if has_bound(case)}


def bound(about: Bounded, progress: Callable[[float], None]) -> Mapping[str, float | None]:
    """The least possible largest distance of the true tip from its path, by change of the load [mm].

    None where the true robot cannot follow its load.
    """
    case, load = about.case, about.case.file.load
    lab = virtual_bench(case.robot, case.lab, about.seed, case.start).lab
    statics, limits = Statics(lab.true_robot, integrator="fourth_order"), case.robot.limits()
    parts = windows(load, case.file.duration)
    found: dict[str, float | None] = dict.fromkeys(window_name(begin) for begin, _ in parts)
    joints = lab.true_joints(case.start)
    try:
        tip = statics.solve(joints, np.zeros(6)).tip
        for number, (begin, end) in enumerate(parts, 1):
            times = begin + _moments(min(end - begin, LONGEST) - BEFORE)
            setpoints = [_setpoint(case, time) for time in times.tolist()]
            course = Course(
                times,
                tip + np.array([setpoint.position for setpoint in setpoints]),
                np.array([load.force(time) for time in times.tolist()]),
            )
            joints = _held(statics, limits, joints, course.targets[0], load.force(begin - BEFORE))
            jacobian = statics.solve(joints, pure_force(course.forces[0])).jacobian[:3]
            velocity = np.linalg.pinv(jacobian) @ setpoints[0].velocity
            best = best_path(statics, limits, joints, velocity, course)
            found[window_name(begin)] = float(np.round(1e3 * best.largest, 4))
            joints = best.joints[-1]
            progress(number / len(parts))
    except NoSolution:
        return found
    return found


def with_bound(numbers: Mapping[str, Any], least: Mapping[str, float | None]) -> dict[str, Any]:
    """The numbers of a case with the bound beside each of its parts, and that of all of them together."""
    parts = {
        name: {**part, "best_possible_mm": least[name]} if name in least else part
        for name, part in numbers.get("by_change", {}).items()
    }
    known = [value for value in least.values() if value is not None]
    if not parts or len(known) < len(least) or not known:
        return dict(numbers)
    return {**numbers, "by_change": parts, "best_possible_mm": max(known)}


def _moments(length: float) -> Array:
    """Times since a change (m,), the closer the nearer to it, up to `length` [s]."""
    times = [0.0]
    while times[-1] < length - 0.5 * CLOSEST:
        times.append(min(times[-1] + min(max(APART * times[-1], CLOSEST), WIDEST), length))
    return np.array(times)


def _held(statics: Statics, limits: Limits, joints: Array, target: Array, force: Array) -> Array:
    """Joints (n,) near those given whose tip under a force (3,) [N] is at a target (3,) [m], as the travel lets it."""
    lower, upper = limits.packed[:2]
    inside = np.clip(joints, lower, upper)
    if np.linalg.norm(statics.solve(inside, pure_force(force)).tip - target) < AT:
        return inside
    found = least_squares(
        lambda q: 1e3 * (statics.solve(q, pure_force(force)).tip - target),
        inside,
        bounds=(lower, upper),
        x_scale=limits.speed,
    )
    return found.x


def _setpoint(case: Case, time: float) -> Setpoint:
    """Where the tip should be, from the start tip."""
    order = case.orders.at(time)
    assert isinstance(order, Setpoint), "swept joints have no bound"  # noqa: S101
    return order
