"""Best possible tip error under a load: a lower bound that follows from the limits of the stages.

Reports compare the error of a controller with this bound. It is computed for the simulated real robot (plant) without
backlash, friction and delay. A motion is divided into parts at each change of its load, and each part has its own
bound. A part starts with the tip at its setpoint and with joints that do not anticipate the load. From then on the
course of the load is known. Computing a bound takes seconds. So the bounds of an experiment are computed only if the
joints cannot compensate at least one of its loads.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, linprog
from scipy.sparse import csr_array, diags_array, eye_array, hstack, kron, vstack

from core.control.trajectories import Setpoint
from core.control.velocity_ik import inverse_at
from core.errors import CtrError, DescriptionError, NoSolution
from core.model.solution import pure_force
from core.model.statics import Solution, Statics
from core.robot.limits import Limits
from core.robot.robot import Array
from station.experiments.case_summary import load_windows, window_name
from station.experiments.experiment import Case
from station.lab.virtual_bench import virtual_bench

#: Largest number of search steps, and of rounds in each step that add missing directions.
MAX_STEPS, MAX_ROUNDS = 40, 4
#: The search ends when the predicted improvement of a step is below this fraction of the largest tip error. It also
#: ends when the largest tip error is below this length [m].
MIN_RELATIVE_GAIN, MIN_GAIN_M = 2e-3, 1e-6
#: Size of the first trust region, and size below which the search ends, as joint travel in seconds at top speed [s].
FIRST_TRUST_REGION_S, MIN_TRUST_REGION_S = 0.5, 1e-3
#: Time constant with which the greedy initial path approaches its target [s].
GREEDY_TIME_CONSTANT_S = 0.1


class LoadCourse(NamedTuple):
    """Course of load and setpoint, sampled at chosen times."""

    times: Array  #: (m,) increasing times [s]
    targets: Array  #: (m, 3) desired tip positions, world frame [m]
    forces: Array  #: (m, 3) forces at the tip, world frame [N]


class BestPath(NamedTuple):
    """The optimal joint path and its tip errors."""

    joints: Array  #: (m, n) joint positions [rad or m]
    errors: Array  #: (m, 3) target minus tip, world frame [m]

    @property
    def largest(self) -> float:
        """Largest distance between tip and target [m]."""
        return float(np.linalg.norm(self.errors, axis=1).max())


def best_path(statics: Statics, limits: Limits, joints: Array, velocity: Array, course: LoadCourse) -> BestPath:
    """Return the joint path whose largest tip error is as small as possible.

    The computation knows the whole course of load and setpoint in advance, without noise, delay or model error. No real
    controller can do better.

        minimise  max_k |F(q_k, w_k) - target_k|
        subject to  q_0 given,  |q_k+1 - q_k| <= speed dt,  |v_k+1 - v_k| <= acceleration dt,  travel

    Sequential linear programming solves this problem. The model's tip F is linearised along the path with the Jacobian
    J(q, w). The distance to the target is approximated by the largest projection of the tip error on a set of
    directions; missing directions are added (Kelley 1960). Each step stays within a trust region. The result is a local
    minimum: the search starts from a greedy path that moves straight toward the target.

    Args:
        statics: model of the simulated real robot.
        limits: speed, acceleration and travel of its joints; limits of several joints together are ignored.
        joints: joint positions at the first time (n,) [rad or m].
        velocity: joint velocities before the first time (n,) [rad/s or m/s].
        course: load and setpoint over time.

    Raises:
        DescriptionError: the course has fewer than two times, or its times do not increase.
        CtrError: the robot has no valid pose at `joints` under the first force.

    """
    if len(course.times) < 2 or not (np.diff(course.times) > 0.0).all():
        raise DescriptionError(f"a course needs at least two increasing times; it has {len(course.times)}")
    program = _Program(limits, velocity, course.times)
    path = _Path.solved(statics, course, _greedy(statics, limits, joints, velocity, course), None)
    directions = [[*np.eye(3), *-np.eye(3)] for _ in course.times]
    trust = FIRST_TRUST_REGION_S
    for _ in range(MAX_STEPS):
        moved, promised = program.step(path, directions, trust)
        gain = path.largest - promised
        if (
            path.largest < MIN_GAIN_M
            or gain < max(MIN_RELATIVE_GAIN * path.largest, 0.1 * MIN_GAIN_M)
            or trust < MIN_TRUST_REGION_S
        ):
            break
        try:
            candidate = _Path.solved(statics, course, path.joints + moved, path)
        except CtrError:
            trust *= 0.3
            continue
        kept = (path.largest - candidate.largest) / gain
        if kept > 0.1:
            path = candidate
        trust *= 2.0 if kept > 0.7 else 1.0 if kept > 0.3 else 0.3
    return BestPath(path.joints, path.errors)


@dataclass(frozen=True)
class _Path:
    """A joint path that the model has solved: its tip errors, Jacobians and solutions."""

    joints: Array  #: (m, n) joint positions [rad or m]
    errors: Array  #: (m, 3) target minus tip [m]
    jacobians: Array  #: (m, 3, n) derivatives of the tip positions by the joints
    solutions: tuple[Solution, ...]

    @staticmethod
    def solved(statics: Statics, course: LoadCourse, joints: Array, near: "_Path | None") -> "_Path":
        """Solve the model along `joints` (m, n); each solve starts from the path `near` or the previous point."""
        found: list[Solution] = []
        for k, (q, force) in enumerate(zip(joints, course.forces, strict=True)):
            guess = near.solutions[k] if near is not None else found[-1] if found else None
            found.append(statics.solve(q, pure_force(force), guess))
        errors = course.targets - np.array([each.tip for each in found])
        return _Path(joints, errors, np.array([each.jacobian[:3] for each in found]), tuple(found))

    @property
    def largest(self) -> float:
        """Largest distance between tip and target on the path [m]."""
        return float(np.linalg.norm(self.errors, axis=1).max())


class _Program:
    """The linear program of each search step; joint steps are travel times at top speed [s].

    Its unknowns are the joint steps at all times but the first, ordered by time, and the largest tip error [mm].
    """

    def __init__(self, limits: Limits, velocity: Array, times: Array) -> None:
        self._lower, self._upper, self._speed, acceleration = limits.packed[:4]
        self._dt = np.diff(times)
        self._start = velocity / self._speed
        m, n = len(self._dt), len(self._speed)
        # `_velocity` maps joint steps at times 1 ... m to the velocities of the m intervals, as fractions of top speed.
        difference = eye_array(m) - eye_array(m, k=-1)
        self._velocity = kron(diags_array(1.0 / self._dt) @ difference, eye_array(n), format="csr")
        self._change = kron(difference, eye_array(n), format="csr") @ self._velocity
        self._max_change = (_time_steps(self._dt)[:, None] * (acceleration / self._speed)).ravel()
        fixed = vstack((self._velocity, -self._velocity, self._change, -self._change))
        self._fixed = hstack((fixed, csr_array((4 * m * n, 1))), format="csr")
        self._shape = m, n

    def step(self, path: _Path, directions: Sequence[list[Array]], trust: float) -> tuple[Array, float]:
        """Return steps (m + 1, n) [rad or m] and the predicted largest error [m]; add missing `directions` in place."""
        m, n = self._shape
        offset = ((path.joints[1:] - path.joints[0]) / self._speed).ravel()
        rate, change = self._velocity @ offset, self._change @ offset
        change[:n] -= self._start
        # Where the present path violates a bound, a step need not repair the violation but must not make it worse.
        max_rate, max_change = np.maximum(1.0, np.abs(rate)), np.maximum(self._max_change, np.abs(change))
        room = np.concatenate((max_rate - rate, max_rate + rate, max_change - change, max_change + change))
        low = np.minimum((self._lower - path.joints[1:]) / self._speed, 0.0).ravel()
        high = np.maximum((self._upper - path.joints[1:]) / self._speed, 0.0).ravel()
        least = 1e3 * float(np.linalg.norm(path.errors[0]))
        bounds = np.empty((m * n + 1, 2))
        bounds[:-1, 0], bounds[:-1, 1], bounds[-1] = np.maximum(low, -trust), np.minimum(high, trust), (least, np.inf)
        scaled = 1e3 * path.jacobians[1:] * self._speed  # (m, 3, n) [mm/s]
        errors = 1e3 * path.errors[1:]
        steps, largest = np.zeros((m, n)), 1e3 * path.largest
        for _ in range(MAX_ROUNDS):
            rows, limit = _cuts(scaled, errors, directions)
            goal = np.zeros(m * n + 1)
            goal[-1] = 1.0
            found = linprog(
                goal, vstack((self._fixed, rows)), np.concatenate((room, limit)), bounds=bounds, method="highs"
            )
            if found.x is None:  # the present path is always feasible: only rounding can prevent a solution
                break
            steps, largest = found.x[:-1].reshape(m, n), float(found.x[-1])
            left = errors - np.einsum("kij,kj->ki", scaled, steps)
            beyond = np.linalg.norm(left, axis=1)
            missing = np.flatnonzero(beyond > largest * (1.0 + 0.3 * MIN_RELATIVE_GAIN) + 1e3 * 0.1 * MIN_GAIN_M)
            for k in missing.tolist():
                directions[k + 1].append(left[k] / beyond[k])
            if not len(missing):
                break
        moved = np.vstack((np.zeros(n), steps * self._speed))
        return moved, 1e-3 * max(largest, least)


def _time_steps(lengths: Array) -> Array:
    """Return the times (m,) between midpoints of successive intervals; the first is half of the first interval."""
    return np.append(0.5 * lengths[:1], 0.5 * (lengths[1:] + lengths[:-1]))


def _cuts(scaled: Array, errors: Array, directions: Sequence[list[Array]]) -> tuple[csr_array, Array]:
    """Return the linear constraints u . (e_k - J_k x_k) <= largest error, one per direction u and time k.

    The result has rows (c, m n + 1) and right sides (c,). e_k is the tip error, J_k the Jacobian and x_k the joint
    step.
    """
    m, _, n = scaled.shape
    counts = [len(each) for each in directions[1:]]
    moment = np.repeat(np.arange(m), counts)
    along = np.array([u for each in directions[1:] for u in each])
    slopes = -np.einsum("ci,cij->cj", along, scaled[moment])
    rows = np.repeat(np.arange(len(moment)), n + 1)
    columns = np.column_stack((moment[:, None] * n + np.arange(n), np.full(len(moment), m * n))).ravel()
    values = np.column_stack((slopes, np.full(len(moment), -1.0))).ravel()
    matrix = csr_array((values, (rows, columns)), shape=(len(moment), m * n + 1))
    return matrix, -np.einsum("ci,ci->c", along, errors[moment])


def _greedy(statics: Statics, limits: Limits, joints: Array, velocity: Array, course: LoadCourse) -> Array:
    """Return an initial path (m, n) that moves straight toward the target, within joint speed and acceleration."""
    lower, upper, _, acceleration = limits.packed[:4]
    path, at = [joints], statics.solve(joints, pure_force(course.forces[0]))
    lengths = np.diff(course.times)
    for k, (dt, apart) in enumerate(zip(lengths, _time_steps(lengths), strict=True), 1):
        desired = (course.targets[k] - at.tip) / max(GREEDY_TIME_CONSTANT_S, dt)
        desired += (course.targets[k] - course.targets[k - 1]) / dt
        found = inverse_at(limits, path[-1], at.jacobian[:3], desired).velocity
        velocity = np.clip(found, velocity - acceleration * apart, velocity + acceleration * apart)
        path.append(np.clip(path[-1] + dt * velocity, lower, upper))
        at = statics.solve(path[-1], pure_force(course.forces[k]), at)
    return np.array(path)


#: Interval between two time samples of a part as a fraction of the time since the load's change; smallest and largest
#: interval [s]. The samples are denser where the load has just changed.
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
