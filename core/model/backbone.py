"""Points along the loaded tubes with their radii and Jacobians, from which distances to regions are computed.

The Jacobian of a point is a difference quotient: the tubes are integrated once more for each joint, with the joint
moved a little and the base unknowns moved with it by their sensitivity. The load stays constant. A point at a fixed
share of the length is a point of the moving curve, so the Jacobian at the last point is that of the tip.
"""

import numpy as np

from core.compiled import compiled
from core.model.propagation import Scheme, propagate
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.limits import Backbone
from core.robot.robot import FLUSH_TOLERANCE_M, Array, tube_poses, unpack

#: Number of points at equal distances along the tubes, from the plate to the tip.
POINTS = 32
#: Change of a joint in the difference quotients [rad or m].
JOINT_STEP = 1e-6


def backbone(statics: Statics, solution: Solution, tip: Array | None = None) -> Backbone:
    """Return points along a solved shape, world frame: from the plate to the tip, then the ends of the outer tubes.

    Args:
        statics: model of the robot.
        solution: solved shape.
        tip: observed position of the tip (3,) [m]; the points move toward it by the square of their share of the
            length, because the model's error grows toward the tip. None: the points are those of the model.
    """
    packed, order, sublink, tubes, _ = statics.compiled_arguments
    n, q = len(statics.robot.joints), len(tubes)
    m = POINTS + q - 1
    found, shares = Backbone(np.empty((m, 3)), np.empty(m), np.empty((m, 3, n)), POINTS), np.empty(m)
    _sample(
        packed, order, sublink, solution.joints, solution.wrench, solution.contact, solution.unknowns,
        solution.sensitivity, statics.outer_radii, tubes, *found[:3], shares,
        np.empty((statics.max_sections, 16 + 2 * q)),
    )  # fmt: skip
    if tip is not None:
        found.points[:] += shares[:, None] ** 2 * (tip - solution.tip)
    return found


@compiled
def _sample(
    packed: Array, order: int, sublink: float, joints: Array, wrench: Array, contact: float, unknowns: Array,
    sensitivity: Array, outer_radii: Array, tubes: tuple[float, ...],
    points: Array, radii: Array, jacobian: Array, shares: Array, path: Array,
) -> None:  # fmt: skip
    """Compute a `Backbone` and each point's share of the length (m,); `path` is work space."""
    layout, scheme, q = unpack(packed), Scheme(order, sublink), len(tubes)
    m, state, rates = points.shape[0], np.empty(18 + 2 * q), np.empty(0)
    moved, shifted, moved_points, ends = joints.copy(), unknowns.copy(), np.empty_like(points), np.empty(q)
    for j in range(-1, joints.shape[0]):
        for k in range(joints.shape[0]):
            moved[k] = joints[k] + (JOINT_STEP if k == j else 0.0)
        for k in range(unknowns.shape[0]):
            shifted[k] = unknowns[k] + (JOINT_STEP * sensitivity[k, j] if j >= 0 else 0.0)
        alpha, beta, _ = tube_poses(layout, moved)
        for i in range(q):
            ends[i] = beta[i] + layout.ends[i, layout.counts[i] - 1]
        passed = propagate(layout, scheme, alpha, beta, wrench[:3], contact, shifted, tubes, (), state, rates, path)
        length = path[passed - 1, 0]
        for i in range(m):
            s = length * i / (POINTS - 1) if i < POINTS else min(ends[i - POINTS + 1], length)
            point = points[i] if j < 0 else moved_points[i]
            _point(path, passed, s, point)
            for k in range(3):
                point[k] += layout.base[9 + k]
                if j >= 0:
                    jacobian[i, k, j] = (point[k] - points[i, k]) / JOINT_STEP
            if j < 0:
                shares[i], radii[i] = s / length, 0.0
                for tube in range(q):
                    if s <= ends[tube] + FLUSH_TOLERANCE_M:
                        radii[i] = max(radii[i], outer_radii[tube])


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
