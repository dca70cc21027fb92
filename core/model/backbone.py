"""Points along the loaded tubes with their radii, Jacobians and expected motion, for distances to regions.

The Jacobian of a point is a difference quotient: the tubes are integrated once more for each joint, with the joint
moved a little and the base unknowns changed by their sensitivity. The load stays constant. Each point stays at a fixed
fraction of the moving curve's length, so the Jacobian of the last point is that of the tip. The motion that a changing
load causes is a difference quotient, too.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.model.propagation import Scheme, propagate
from core.model.solution import CONTACT_POSITION, Solution, fields
from core.model.statics import Statics
from core.robot.limits import Backbone
from core.robot.robot import FLUSH_TOLERANCE_M, Array, tube_poses, unpack

#: Number of points at equal distances along the tubes, from the plate to the tip.
POINTS = 32
#: Change of a joint in the difference quotients [rad or m].
JOINT_STEP = 1e-6
#: Time step with which the load changes in the difference quotient [s].
LOAD_STEP_S = 1e-3
#: Rate of a constant force [N/s].
NO_FORCE_RATE = np.zeros(3)


class ExpectedMotion(NamedTuple):
    """Motion of the robot that a command sent now cannot change."""

    travel: Array  #: (n,) distance that the joints still move until such a command takes effect [rad or m]
    force_rate: Array  #: (3,) rate of the force on the tip [N/s]
    tip_drift: Array  #: (3,) tip velocity that neither the joints nor the load explain [m/s]
    lead_time: float  #: time until such a command takes effect [s]


def backbone(
    statics: Statics, solution: Solution, tip: Array | None = None, expected: ExpectedMotion | None = None,
    weights: Array | None = None,
) -> Backbone:  # fmt: skip
    """Return points along a solved shape, world frame: from the plate to the last tube end, then the other tubes' ends.

    Args:
        statics: model of the robot.
        solution: solved shape.
        tip: observed position of the tip (3,) [m], to which the points move. None: the points are those of the model.
        expected: motion of the robot that a command sent now cannot change; None: the robot is at rest.
        weights: displacement of each point per displacement of the tip (m, 3, 3). None: the square of the point's
            share of the length to the tip, because the model's error grows toward the tip.
    """
    n = len(statics.robot.joints)
    if expected is None:
        expected = ExpectedMotion(np.zeros(n), NO_FORCE_RATE, np.zeros(3), 0.0)
    found, shares = _sampled(statics, solution, n, expected.force_rate)
    if weights is None:
        weights = shares[:, None, None] ** 2 * np.eye(3)
    displacement = np.zeros(3) if tip is None else tip - solution.tip
    _move(
        found.points, found.jacobian, found.drift, found.ahead, weights, displacement, expected.travel,
        expected.tip_drift, expected.lead_time,
    )  # fmt: skip
    return found


def centre_line(statics: Statics, solution: Solution) -> tuple[Array, Array]:
    """Return the points (m, 3) [m] of `backbone`, and their shares of the tip's arc length (m,)."""
    found, shares = _sampled(statics, solution, 0, NO_FORCE_RATE)
    return found.points, shares


def tip_point(statics: Statics, solution: Solution) -> int:
    """Return the index of the tip among the points of `backbone`."""
    return POINTS if _last_tube(statics.robot.tube_ends(solution.joints)) > 0 else POINTS - 1


@compiled
def _last_tube(ends: Array) -> int:
    """Return the index of the tube that ends last: 0 (the innermost tube) if its end is flush with the last end."""
    last = 0
    for i in range(1, ends.size):
        if ends[i] > ends[last] + FLUSH_TOLERANCE_M:
            last = i
    return last


def _sampled(statics: Statics, solution: Solution, joints: int, force_rate: Array) -> tuple[Backbone, Array]:
    """Return points with Jacobians by the first `joints` joints, and their shares of the length to the tip (m,)."""
    packed, order, sublink, tubes, _ = statics.compiled_arguments
    q = len(tubes)
    m = POINTS + q - 1
    at_rest = np.zeros((m, 3)), np.zeros((m, 3))
    found, shares = Backbone(np.empty((m, 3)), np.empty(m), np.empty((m, 3, joints)), *at_rest, POINTS), np.empty(m)
    _sample(
        packed, order, sublink, solution.numbers, statics.outer_radii, tubes, force_rate, *found[:4], shares,
        statics.max_sections,
    )  # fmt: skip
    return found, shares


@compiled
def _sample(
    packed: Array, order: int, sublink: float, solution: Array, outer_radii: Array, tubes: tuple[float, ...],
    force_rate: Array, points: Array, radii: Array, jacobian: Array, drift: Array, shares: Array, max_sections: int,
) -> None:  # fmt: skip
    """Compute the parts of a `Backbone` and each point's share of the length to the tip (m,) from a solution's numbers.

    `drift` becomes the velocity of the points that `force_rate` causes.
    """
    layout, scheme, q, at = unpack(packed), Scheme(order, sublink), len(tubes), fields(solution)
    joints, unknowns, sensitivity, contact = at.joints, at.unknowns, at.sensitivity, solution[CONTACT_POSITION]
    m, n, wrench, moved, shifted = points.shape[0], joints.shape[0], at.wrench.copy(), joints.copy(), unknowns.copy()
    state, rates, moved_points, ends = np.empty(18 + 2 * q), np.empty(0), np.empty_like(points), np.empty(q)
    path = np.empty((max_sections, 16 + 2 * q))
    load = jacobian.shape[2]
    for j in range(-1, load + 1):  # -1: the shape; `load`: its change by the load
        if j == load and force_rate[0] == 0.0 and force_rate[1] == 0.0 and force_rate[2] == 0.0:
            break
        for k in range(n):
            moved[k] = joints[k] + (JOINT_STEP if k == j < load else 0.0)
        for k in range(unknowns.shape[0]):
            shifted[k] = unknowns[k] + (JOINT_STEP * sensitivity[k, j] if 0 <= j < load else 0.0)
        if j == load:
            for i in range(3):
                wrench[i] += LOAD_STEP_S * force_rate[i]
                for k in range(unknowns.shape[0]):
                    shifted[k] += LOAD_STEP_S * force_rate[i] * sensitivity[k, n + i]
        alpha, beta, _ = tube_poses(layout, moved)
        for i in range(q):
            ends[i] = beta[i] + layout.ends[i, layout.counts[i] - 1]
        passed = propagate(layout, scheme, alpha, beta, wrench, contact, shifted, tubes, (), state, rates, path)
        length, last_tube = path[passed - 1, 0], _last_tube(ends)
        for i in range(m):
            other = i - POINTS if i - POINTS < last_tube else i - POINTS + 1  # each tube but `last_tube`
            s = length * i / (POINTS - 1) if i < POINTS else min(ends[other], length)
            point = points[i] if j < 0 else moved_points[i]
            _point(path, passed, s, point)
            for k in range(3):
                point[k] += layout.base[9 + k]
                if j == load:
                    drift[i, k] = (point[k] - points[i, k]) / LOAD_STEP_S
                elif j >= 0:
                    jacobian[i, k, j] = (point[k] - points[i, k]) / JOINT_STEP
            if j < 0:
                shares[i], radii[i] = s / length, 0.0
                if last_tube > 0 or length == 0.0:  # the tubes beyond the tip move as the tip does
                    shares[i] = s / ends[0] if s < ends[0] else 1.0
                for tube in range(q):
                    if s <= ends[tube] + FLUSH_TOLERANCE_M:
                        radii[i] = max(radii[i], outer_radii[tube])


@compiled
def _move(
    points: Array, jacobian: Array, drift: Array, ahead: Array, weights: Array, displacement: Array, travel: Array,
    tip_drift: Array, lead_time: float,
) -> None:  # fmt: skip
    """Move the points with the tip's displacement, add the tip's drift, and write their displacement to `ahead`."""
    for i in range(points.shape[0]):
        for k in range(3):
            for l in range(3):  # noqa: E741 - pairs with k
                points[i, k] += weights[i, k, l] * displacement[l]
                drift[i, k] += weights[i, k, l] * tip_drift[l]
            ahead[i, k] = lead_time * drift[i, k]
            for j in range(travel.size):
                ahead[i, k] += jacobian[i, k, j] * travel[j]


@compiled
def _point(path: Array, passed: int, s: float, point: Array) -> None:
    """Write the position at arc length s [m] on a path of cross-sections, cubic between its rows."""
    row = 0
    while row < passed - 2 and path[row + 1, 0] <= s:
        row += 1
    step = path[row + 1, 0] - path[row, 0]
    u = min(max((s - path[row, 0]) / step, 0.0), 1.0) if step > 0.0 else 1.0
    a, b = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * u * (3.0 - 2.0 * u)
    c, d = u * (1.0 - u) ** 2 * step, u * u * (u - 1.0) * step
    for k in range(3):
        point[k] = (
            a * path[row, 10 + k] + c * path[row, 3 + 3 * k] + b * path[row + 1, 10 + k] + d * path[row + 1, 3 + 3 * k]
        )
