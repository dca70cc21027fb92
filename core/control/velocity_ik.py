"""Inverse velocity kinematics: joint velocities for a desired tip velocity, damped and inside every limit.

    minimise  |J v - desired|^2 + damping^2 |v / speed|^2 (+ ridge (|(v - preferred) / speed|^2 + |resisted v|^2))
    subject to  lower <= v <= upper,  rows v <= room

v are the joint velocities. The Jacobian J has a row for each controlled coordinate of the tip. With more joints than
rows, some joint motions do not move the tip (the null space). A ridge, a penalty far below all other terms, selects
one of these motions inside the same limits: the ridge penalises the distance from `preferred` (zero by default) and the
products with the rows of `resisted` (none by default).

Joint velocities are measured in fractions of their top speed, which makes radians and metres comparable. The singular
values of J diag(speed) are the tip speeds [m/s] with the joints at full speed. Where the smallest singular value is
below a floor, the damping of Nakamura and Hanafusa sets in and keeps the joint velocities finite. Zero velocity
satisfies every limit. A primal active-set method starts at zero velocity and reaches the exact minimum with a few small
eliminations; its final working set contains the active limits.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import NotFinite
from core.robot.limits import Limits
from core.robot.robot import Array

#: The inverse is damped if the smallest singular value of J diag(speed) is below this floor, at any desired tip speed
#: [m/s]. This singular value is the tip speed in the least mobile direction with the joints at full speed.
SIGMA_FLOOR_M_S = 5e-4
#: For desired tip speeds above 1.25 mm/s the floor is higher: sqrt(ADAPTIVE_DAMPING_M_S * |desired|) [m/s]. At poses
#: with aligned tube curves, the undamped joint velocity changes its sign. Because commands arrive late, a joint would
#: oscillate there at full speed without this damping.
ADAPTIVE_DAMPING_M_S = 2e-4
#: Largest singular value of J diag(speed) in the computation; equations with a larger one are scaled down [m/s].
MAX_SIGMA_M_S = 1e3

#: Empty vector `room`, for a robot without limits that combine several joints.
NO_BOUNDS = np.zeros(0)


class Inverse(NamedTuple):
    """Joint velocities of the inverse velocity kinematics, and the limits that are active."""

    velocity: Array  #: (n,) joint velocities [rad/s or m/s]
    sigma: Array  #: (min(m, n),) singular values of J diag(speed), largest first [m/s]
    at_bound: Array  #: (n,) -1: joint velocity at its lower bound; 0: free; 1: at its upper bound
    at_row: Array  #: (m,) 1 where a limit that combines several joints is active, else 0


class VelocityTask(NamedTuple):
    """Equation that the joint velocities should satisfy: jacobian @ joint_velocity = velocity."""

    jacobian: Array  #: (m, n) left side of the equation [m/rad or m/m]
    velocity: Array  #: (m,) right side of the equation, a tip velocity [m/s]


class VelocityLimits(NamedTuple):
    """Bounds that the joint velocities v must satisfy: lower <= v <= upper, rows @ v <= room; zero is allowed."""

    speed: Array  #: (n,) top speeds of the joints, used as units [rad/s or m/s]
    lower: Array  #: (n,) smallest joint velocities, at most 0 [rad/s or m/s]
    upper: Array  #: (n,) largest joint velocities, at least 0 [rad/s or m/s]
    rows: Array  #: (k, n) matrix G of the limits of several joints
    room: Array  #: (k,) vector h of these limits, not negative


class NullSpace(NamedTuple):
    """Objective that selects among the joint velocities that fulfil the task equally well."""

    velocity: Array  #: (n,) desired joint velocity [rad/s or m/s]
    resisted: Array  #: (k, n) rows whose products with the joint velocity are penalised [s/rad or s/m]


def inverse(
    jacobian: Array, desired: Array, speed: Array, lower: Array, upper: Array,
    rows: Array | None = None, room: Array = NO_BOUNDS, preferred: Array | None = None, resisted: Array | None = None,
) -> Inverse:  # fmt: skip
    """Return the joint velocity that best gives the desired tip velocity inside the limits.

    Args:
        jacobian: rows of the task (m, n) [m/rad or m/m].
        desired: desired tip velocity (m,) [m/s].
        speed: top speeds of the joints (n,), used as units [rad/s or m/s].
        lower, upper: bounds of the joint velocities (n,); zero is between them [rad/s or m/s].
        rows, room: limits of several joints, rows (k, n) @ velocity <= room (k,); room is not negative.
        preferred: joint velocity (n,) near which the solution is chosen among equally good velocities [rad/s or m/s];
            zero by default.
        resisted: rows (k, n) whose products with the joint velocity are penalised [s/rad or s/m]; none by default.

    Raises:
        NotFinite: the desired velocity or the Jacobian contains a NaN or an infinity.

    """
    n = speed.shape[0]
    preferred = zero_velocity(n) if preferred is None else preferred
    rows, resisted = (no_rows(n) if given is None else given for given in (rows, resisted))
    *found, finite = _inverse(jacobian, desired, speed, lower, upper, rows, room, preferred, resisted)
    if not finite:
        _raise_not_finite(jacobian, desired)
    return Inverse(*found)


def inverse_at(limits: Limits, joints: Array, jacobian: Array, desired: Array) -> Inverse:
    """Compute `inverse` with velocity bounds that let joints at `joints` (n,) [rad or m] stop inside their travel."""
    return inverse(jacobian, desired, limits.speed, *limits.velocity_bounds(joints))


def _raise_not_finite(jacobian: Array, desired: Array) -> None:
    if not np.isfinite(desired).all():
        raise NotFinite(f"desired tip velocity {desired.tolist()} m/s is not finite")
    if not np.isfinite(jacobian).all():
        raise NotFinite(f"Jacobian {jacobian.tolist()} is not finite")
    raise NotFinite(f"tip velocity {desired.tolist()} m/s or Jacobian {jacobian.tolist()} is too large to compute with")


@cache
def no_rows(joints: int) -> Array:
    """Return an empty matrix (0, n) for a robot without limits of several joints together."""
    return np.empty((0, joints))


@cache
def zero_velocity(joints: int) -> Array:
    """Return the default preferred joint velocity: zero."""
    return np.zeros(joints)


@compiled
def inverse_law(
    task: VelocityTask, limits: VelocityLimits, null_space: NullSpace, min_floor: float
) -> tuple[Array, Array, Array, Array, bool]:
    """Compute `inverse` in compiled code; the unknowns are x = v / speed.

    Each limit has a number c: c < n is the upper bound of joint c, n <= c < 2 n the lower bound of joint c - n, and
    other numbers the row c - 2 n.
    """
    jacobian, desired = task
    speed, lower, upper, rows, room = limits
    preferred, resisted = null_space
    n, m, size = speed.shape[0], rows.shape[0], desired.shape[0]
    scaled, total, square = np.empty((size, n)), 0.0, 0.0
    for i in range(size):
        square += desired[i] * desired[i]
        for j in range(n):
            scaled[i, j] = jacobian[i, j] * speed[j]
            total += scaled[i, j] * scaled[i, j]
    sigma = _singular_values(scaled)
    velocity, at_bound, at_row = np.zeros(n), np.zeros(n), np.zeros(m)
    for i in range(n):
        total += preferred[i] * preferred[i]
    # The squares of these numbers must not overflow: comparisons with the resulting NaN would allow full speed.
    if not np.isfinite(total + square):
        return velocity, sigma, at_bound, at_row, False
    requested = np.sqrt(square)
    floor = max(min_floor, np.sqrt(ADAPTIVE_DAMPING_M_S * requested))
    ratio = sigma[-1] / floor
    damping = floor * floor * (1.0 - ratio * ratio) if ratio < 1.0 else 0.0
    # With more joints than rows, a ridge far below the damping selects the solution near `preferred`.
    ridge = 1e-10 * sigma[0] * sigma[0] if n > size else 0.0
    damping += ridge
    # Equations of custom loops can be so large that rounding would exceed the tolerances below. Scaling by a power of
    # two adds no rounding.
    shrink = 1.0 if sigma[0] < MAX_SIGMA_M_S else 2.0 ** -np.floor(np.log2(sigma[0]))
    damping, ridge = damping * shrink * shrink, ridge * shrink * shrink
    normal, right = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        right[i] = ridge * preferred[i] / speed[i]
        for k in range(size):
            right[i] += scaled[k, i] * shrink * (desired[k] * shrink)
            for j in range(n):
                normal[i, j] += scaled[k, i] * shrink * (scaled[k, j] * shrink)
        normal[i, i] += damping
    for k in range(resisted.shape[0]):
        for i in range(n):
            for j in range(n):
                normal[i, j] += ridge * resisted[k, i] * speed[i] * resisted[k, j] * speed[j]
    x, row = np.zeros(n), np.empty(n)
    working, count = np.empty(n, np.int64), 0
    system, step = np.empty((2 * n, 2 * n)), np.empty(2 * n)
    for _ in range(20 * (n + m)):
        # Solve for the minimum with the limits of the working set as equations: step (n) and multipliers (count).
        for i in range(n):
            step[i] = right[i]
            for j in range(n):
                system[i, j] = normal[i, j]
                step[i] -= normal[i, j] * x[j]
        for k in range(count):
            _limit(working[k], n, speed, rows, row)
            step[n + k] = 0.0
            for j in range(n):
                system[n + k, j] = system[j, n + k] = row[j]
            for l in range(count):  # noqa: E741 - pairs with k
                system[n + k, n + l] = 0.0
        if not _eliminate(system, step, n + count):
            break
        # Move along the step as far as the other limits allow.
        part, block = 1.0, -1
        for c in range(2 * n + m):
            kept = False
            for k in range(count):
                kept = kept or working[k] == c
            if kept:
                continue
            _limit(c, n, speed, rows, row)
            along, left = 0.0, 0.0
            if c < n:
                left = upper[c] / speed[c]
            elif c < 2 * n:
                left = -lower[c - n] / speed[c - n]
            else:
                left = room[c - 2 * n]
            for j in range(n):
                along += row[j] * step[j]
                left -= row[j] * x[j]
            if along > 1e-12 and left < part * along:
                part, block = max(left, 0.0) / along, c
        for j in range(n):
            x[j] += part * step[j]
        # A full working set leaves no direction, so its step is only rounding. Where more limits than joints meet, such
        # a step may seem to cross a further limit, for which the set has no room.
        if block >= 0 and count < n:
            working[count] = block
            count += 1
            continue
        # Remove the limit with the most negative multiplier from the working set.
        worst, drop = -1e-14, -1
        for k in range(count):
            if step[n + k] < worst:
                worst, drop = step[n + k], k
        if drop < 0:
            break
        count -= 1
        working[drop] = working[count]
    for k in range(count):
        c = working[k]
        if c < n:
            at_bound[c] = 1.0
        elif c < 2 * n:
            at_bound[c - n] = -1.0
        else:
            at_row[c - 2 * n] = 1.0
    for i in range(n):
        total += x[i]
        velocity[i] = min(max(x[i] * speed[i], lower[i]), upper[i])
    return velocity, sigma, at_bound, at_row, bool(np.isfinite(total))


@compiled
def _inverse(
    jacobian: Array, desired: Array, speed: Array, lower: Array, upper: Array,
    rows: Array, room: Array, preferred: Array, resisted: Array,
) -> tuple[Array, Array, Array, Array, bool]:  # fmt: skip
    """Call `inverse_law` with arrays, because every record in a call from Python takes two microseconds."""
    return inverse_law(
        VelocityTask(jacobian, desired),
        VelocityLimits(speed, lower, upper, rows, room),
        NullSpace(preferred, resisted),
        SIGMA_FLOOR_M_S,
    )


@compiled
def _limit(c: int, n: int, speed: Array, rows: Array, row: Array) -> None:
    """Write the coefficients of limit number c for the unknowns x to `row`."""
    for j in range(n):
        row[j] = rows[c - 2 * n, j] * speed[j] if c >= 2 * n else 1.0 if j == c else -1.0 if j == c - n else 0.0


@compiled
def _eliminate(matrix: Array, right: Array, size: int) -> bool:
    """Solve a linear system by Gaussian elimination with row pivoting; `right` becomes the solution.

    Only the first `size` rows are used. Return False if the matrix is singular.
    """
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 1e-300:
            return False
        if pivot != k:
            for j in range(k, size):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, size):
                matrix[i, j] -= factor * matrix[k, j]
            right[i] -= factor * right[k]
    for k in range(size - 1, -1, -1):
        for j in range(k + 1, size):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]
    return True


@compiled
def _singular_values(matrix: Array) -> Array:
    """Return the singular values of a matrix (m, n), largest first, by one-sided Jacobi rotations of its rows."""
    m, n = matrix.shape
    rows = matrix.copy()
    for _ in range(12):
        turned = 0.0
        for p in range(m - 1):
            for q in range(p + 1, m):
                a, b, c = 0.0, 0.0, 0.0
                for j in range(n):
                    a += rows[p, j] * rows[p, j]
                    b += rows[q, j] * rows[q, j]
                    c += rows[p, j] * rows[q, j]
                if abs(c) > 1e-15 * np.sqrt(a * b):
                    turned = 1.0
                    zeta = 0.5 * (b - a) / c
                    t = 1.0 / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                    t = t if zeta >= 0.0 else -t
                    cos = 1.0 / np.sqrt(1.0 + t * t)
                    for j in range(n):
                        up, down = rows[p, j], rows[q, j]
                        rows[p, j] = cos * (up - t * down)
                        rows[q, j] = cos * (t * up + down)
        if turned == 0.0:
            break
    sigma = np.empty(m)
    for i in range(m):
        square = 0.0
        for j in range(n):
            square += rows[i, j] * rows[i, j]
        sigma[i] = np.sqrt(square)
    for i in range(m - 1):  # bubble sort of a few numbers: a library's sort would take a second to compile
        for k in range(m - 1 - i):
            if sigma[k] < sigma[k + 1]:
                sigma[k], sigma[k + 1] = sigma[k + 1], sigma[k]
    return sigma[: min(m, n)].copy()
