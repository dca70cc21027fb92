"""From a wanted tip velocity to joint velocities, damped near singular poses and inside bounds.

Joints are measured in fractions of their top speed, which makes radians and metres comparable:
the singular values of J diag(speed) are tip speeds [m/s] with the joints at full speed. Below
`sigma_floor` the damping of Nakamura and Hanafusa sets in, so that no pose demands endless speed.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import NotFinite
from core.robot import Array

#: Tip speed in the worst direction below which the inverse is damped [m/s].
SIGMA_FLOOR = 5e-4


class Inverse(NamedTuple):
    """Joint velocities and how they were limited."""

    velocity: Array  #: (n,) [rad/s or m/s]
    sigma: Array  #: (min(3, n),) singular values of J diag(speed), largest first [m/s]
    at_bound: Array  #: (n,) -1, 0 or 1: held at its lower bound, free, at its upper


def inverse(jacobian: Array, wanted: Array, speed: Array, lower: Array, upper: Array) -> Inverse:
    """Joint velocity that best gives the wanted tip velocity inside the bounds.

    Minimises |J v - wanted|^2 + damping^2 |v / speed|^2 over lower <= v <= upper.

    Args:
        jacobian: (3, n) [m/rad or m/m].
        wanted: (3,) [m/s].
        speed: top speeds (n,), the joints' units of measure [rad/s or m/s].
        lower, upper: bounds (n,) that contain zero [rad/s or m/s].

    """
    if not np.isfinite(wanted).all():
        raise NotFinite(f"wanted tip velocity {wanted.tolist()} m/s is not finite")
    if not np.isfinite(jacobian).all():
        raise NotFinite(f"Jacobian {jacobian.tolist()} is not finite")
    return Inverse(*_inverse(np.ascontiguousarray(jacobian), wanted, speed, lower, upper, SIGMA_FLOOR))


@compiled
def _inverse(
    jacobian: Array, wanted: Array, speed: Array, lower: Array, upper: Array, floor: float
) -> tuple[Array, Array, Array]:
    n = speed.shape[0]
    scaled = jacobian * speed
    sigma = np.linalg.svd(scaled)[1]
    ratio = sigma[-1] / floor
    damping = floor * floor * (1.0 - ratio * ratio) if ratio < 1.0 else 0.0
    # More joints than directions leave a null space: a ridge far below the damping keeps it still.
    damping += 1e-10 * sigma[0] * sigma[0] if n > 3 else 0.0
    normal, right = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        for j in range(n):
            for k in range(3):
                normal[i, j] += scaled[k, i] * scaled[k, j]
        for k in range(3):
            right[i] += scaled[k, i] * wanted[k]
        normal[i, i] += damping
    at_bound = np.zeros(n)
    x = np.zeros(n)
    # Active set: hold the joint that leaves its bounds most, let go one that pulls inward.
    for _ in range(4 * n + 4):
        free = np.flatnonzero(at_bound == 0.0)
        for i in range(n):
            if at_bound[i] > 0.0:
                x[i] = upper[i] / speed[i]
            elif at_bound[i] < 0.0:
                x[i] = lower[i] / speed[i]
        if free.size > 0:
            matrix, target = np.empty((free.size, free.size)), np.empty(free.size)
            for a in range(free.size):
                target[a] = right[free[a]]
                for j in range(n):
                    if at_bound[j] != 0.0:
                        target[a] -= normal[free[a], j] * x[j]
                for b in range(free.size):
                    matrix[a, b] = normal[free[a], free[b]]
            solved = np.linalg.solve(matrix, target)
            for a in range(free.size):
                x[free[a]] = solved[a]
        worst, change = 1e-12, -1
        for i in range(n):
            if at_bound[i] == 0.0:
                over = max(x[i] - upper[i] / speed[i], lower[i] / speed[i] - x[i])
                if over > worst:
                    worst, change = over, i
        if change >= 0:
            at_bound[change] = 1.0 if x[change] > 0.0 else -1.0
            continue
        pull_most = 0.0
        for i in range(n):
            pull = right[i]
            for j in range(n):
                pull -= normal[i, j] * x[j]
            if at_bound[i] * pull < pull_most:
                pull_most, change = at_bound[i] * pull, i
        if change < 0:
            break
        at_bound[change] = 0.0
    velocity = np.empty(n)
    for i in range(n):
        velocity[i] = min(max(x[i] * speed[i], lower[i]), upper[i])
    return velocity, sigma, at_bound
