"""The best that stages of these speeds could do against a load: the joint path with the smallest largest tip error.

Known beforehand is the whole course of load and setpoint, from its first moment on; nothing is noise, delay or
error of the model. What no controller can do better is a fair yardstick for those that know none of it.

    minimise  max_k |F(q_k, w_k) - target_k|
    subject to  q_0 given,  |q_k+1 - q_k| <= speed dt,  |v_k+1 - v_k| <= acceleration dt,  travel

by sequential linear programming: F is linearised along the path with J(q, w), the distance is the largest of its
projections on directions that are added where they are missing (Kelley 1960), and steps stay within a trust region.
The minimum is a local one, next to the path that a greedy inverse takes.
"""

# scipy has no types
# pyright: basic

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, eye_array, hstack, kron, vstack

from core.control.inverse import inverse_at
from core.errors import CtrError, DescriptionError
from core.model.solution import pure_force
from core.model.statics import Solution, Statics
from core.robot.limits import Limits
from core.robot.robot import Array

#: Steps of the sequential program, and of the directions in each of them, at most.
MOST_STEPS, MOST_ROUNDS = 40, 4
#: A path is the best when a step promises less than this part of its largest error, or less than this [m].
GAIN, ENOUGH = 2e-3, 1e-6
#: How far a step may go at first, and where there is no use in trying on [s at top speed].
TRUST, LEAST_TRUST = 0.5, 1e-3
#: In which the greedy path closes in on its target [s].
GREEDY = 0.1


class Course(NamedTuple):
    """What happens, at moments of one's own choice."""

    times: Array  #: (m,) rising [s]
    targets: Array  #: (m, 3) of the tip, world frame [m]
    forces: Array  #: (m, 3) at the tip, world frame [N]


class BestPath(NamedTuple):
    """The best joints and what they leave."""

    joints: Array  #: (m, n) [rad or m]
    errors: Array  #: (m, 3) target minus tip, world frame [m]

    @property
    def largest(self) -> float:
        """Largest distance between tip and target [m]."""
        return float(np.linalg.norm(self.errors, axis=1).max())


def best_path(statics: Statics, limits: Limits, joints: Array, velocity: Array, course: Course) -> BestPath:
    """The joint path with the smallest largest tip error.

    Args:
        statics: model of the true robot.
        limits: speed, acceleration and travel of its joints; limits beyond single joints are left out.
        joints: at the first moment (n,) [rad or m].
        velocity: before it (n,) [rad/s or m/s].
        course: of load and setpoint.

    Raises:
        DescriptionError: fewer than two moments, or they do not rise.
        CtrError: the robot cannot stand at `joints` under the first force.

    """
    if len(course.times) < 2 or not (np.diff(course.times) > 0.0).all():
        raise DescriptionError(f"a course needs two moments at least, and rising ones; it has {len(course.times)}")
    program = _Program(limits, velocity, course.times)
    path = _Path.solved(statics, course, _greedy(statics, limits, joints, velocity, course), None)
    directions = [[*np.eye(3), *-np.eye(3)] for _ in course.times]
    trust = TRUST
    for _ in range(MOST_STEPS):
        moved, promised = program.step(path, directions, trust)
        gain = path.largest - promised
        if path.largest < ENOUGH or gain < max(GAIN * path.largest, 0.1 * ENOUGH) or trust < LEAST_TRUST:
            break
        try:
            tried = _Path.solved(statics, course, path.joints + moved, path)
        except CtrError:
            trust *= 0.3
            continue
        kept = (path.largest - tried.largest) / gain
        if kept > 0.1:
            path = tried
        trust *= 2.0 if kept > 0.7 else 1.0 if kept > 0.3 else 0.3
    return BestPath(path.joints, path.errors)


@dataclass(frozen=True)
class _Path:
    """Joints, what they leave, and how that changes with them."""

    joints: Array  #: (m, n)
    errors: Array  #: (m, 3) [m]
    jacobians: Array  #: (m, 3, n)
    solutions: tuple[Solution, ...]

    @staticmethod
    def solved(statics: Statics, course: Course, joints: Array, near: "_Path | None") -> "_Path":
        """The path through `joints` (m, n), solved from one nearby, or point after point."""
        found: list[Solution] = []
        for k, (q, force) in enumerate(zip(joints, course.forces, strict=True)):
            beside = near.solutions[k] if near is not None else found[-1] if found else None
            found.append(statics.solve(q, pure_force(force), beside))
        errors = course.targets - np.array([each.tip for each in found])
        return _Path(joints, errors, np.array([each.jacobian[:3] for each in found]), tuple(found))

    @property
    def largest(self) -> float:
        """Largest distance from the target [m]."""
        return float(np.linalg.norm(self.errors, axis=1).max())


class _Program:
    """One linear program after the other, in steps of the joints measured in seconds at top speed.

    Unknowns are the steps of all moments but the first, moment by moment, and the largest error [mm].
    """

    def __init__(self, limits: Limits, velocity: Array, times: Array) -> None:
        self._lower, self._upper, self._speed, acceleration = limits.packed[:4]
        self._dt = np.diff(times)
        self._start = velocity / self._speed
        m, n = len(self._dt), len(self._speed)
        # Velocities of the m intervals in parts of the top speed, of moments 1 ... m.
        difference = eye_array(m) - eye_array(m, k=-1)
        self._velocity = kron(diags_array(1.0 / self._dt) @ difference, eye_array(n), format="csr")
        self._change = kron(difference, eye_array(n), format="csr") @ self._velocity
        self._most_change = (_apart(self._dt)[:, None] * (acceleration / self._speed)).ravel()
        fixed = vstack((self._velocity, -self._velocity, self._change, -self._change))
        self._fixed = hstack((fixed, csr_array((4 * m * n, 1))), format="csr")
        self._shape = m, n

    def step(self, path: _Path, directions: Sequence[list[Array]], trust: float) -> tuple[Array, float]:
        """Steps (m + 1, n) [rad or m] and the largest error that they promise [m]; `directions` may grow."""
        m, n = self._shape
        place = ((path.joints[1:] - path.joints[0]) / self._speed).ravel()
        rate, change = self._velocity @ place, self._change @ place
        change[:n] -= self._start
        # Where the path that is there breaks a bound, a step need not mend it, but must not make it worse.
        most_rate, most_change = np.maximum(1.0, np.abs(rate)), np.maximum(self._most_change, np.abs(change))
        room = np.concatenate((most_rate - rate, most_rate + rate, most_change - change, most_change + change))
        low = np.minimum((self._lower - path.joints[1:]) / self._speed, 0.0).ravel()
        high = np.maximum((self._upper - path.joints[1:]) / self._speed, 0.0).ravel()
        least = 1e3 * float(np.linalg.norm(path.errors[0]))
        bounds = np.empty((m * n + 1, 2))
        bounds[:-1, 0], bounds[:-1, 1], bounds[-1] = np.maximum(low, -trust), np.minimum(high, trust), (least, np.inf)
        scaled = 1e3 * path.jacobians[1:] * self._speed  # (m, 3, n) [mm/s]
        errors = 1e3 * path.errors[1:]
        steps, largest = np.zeros((m, n)), 1e3 * path.largest
        for _ in range(MOST_ROUNDS):
            rows, limit = _cuts(scaled, errors, directions)
            goal = np.zeros(m * n + 1)
            goal[-1] = 1.0
            found = linprog(
                goal, vstack((self._fixed, rows)), np.concatenate((room, limit)), bounds=bounds, method="highs"
            )
            if found.x is None:  # the path that is there is always a solution: only rounding can be in the way
                break
            steps, largest = found.x[:-1].reshape(m, n), float(found.x[-1])
            left = errors - np.einsum("kij,kj->ki", scaled, steps)
            beyond = np.linalg.norm(left, axis=1)
            missing = np.flatnonzero(beyond > largest * (1.0 + 0.3 * GAIN) + 1e3 * 0.1 * ENOUGH)
            for k in missing.tolist():
                directions[k + 1].append(left[k] / beyond[k])
            if not len(missing):
                break
        moved = np.vstack((np.zeros(n), steps * self._speed))
        return moved, 1e-3 * max(largest, least)


def _apart(lengths: Array) -> Array:
    """Time between the middles of intervals (m,), of which their mean velocities are; of the first, from its start."""
    return np.append(0.5 * lengths[:1], 0.5 * (lengths[1:] + lengths[:-1]))


def _cuts(scaled: Array, errors: Array, directions: Sequence[list[Array]]) -> tuple[csr_array, Array]:
    """Rows (c, m n + 1) and limits (c,) of u . (e_k - J_k x_k) <= largest, one for each direction u of each moment."""
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


def _greedy(statics: Statics, limits: Limits, joints: Array, velocity: Array, course: Course) -> Array:
    """A path to begin with (m, n): each moment straight toward its target, within speed and acceleration."""
    lower, upper, _, acceleration = limits.packed[:4]
    path, at = [joints], statics.solve(joints, pure_force(course.forces[0]))
    lengths = np.diff(course.times)
    for k, (dt, apart) in enumerate(zip(lengths, _apart(lengths), strict=True), 1):
        wanted = (course.targets[k] - at.tip) / max(GREEDY, dt)
        wanted += (course.targets[k] - course.targets[k - 1]) / dt
        found = inverse_at(limits, path[-1], at.jacobian[:3], wanted).velocity
        velocity = np.clip(found, velocity - acceleration * apart, velocity + acceleration * apart)
        path.append(np.clip(path[-1] + dt * velocity, lower, upper))
        at = statics.solve(path[-1], pure_force(course.forces[k]), at)
    return np.array(path)
