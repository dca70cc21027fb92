"""From a wanted tip velocity to joint velocities, damped near singular poses and inside every limit.

    minimise  |J v - wanted|^2 + damping^2 |v / speed|^2 (+ ridge |(v - spare) / speed|^2)
    subject to  lower <= v <= upper,  rows v <= room

J has a row for each number that is asked of the tip. With more joints than rows a ridge, far below everything else, has
those that are left over do what is nearest to `spare`, inside the same limits: nothing, unless told otherwise.

Joints are measured in fractions of their top speed, which makes radians and metres comparable:
the singular values of J diag(speed) are tip speeds [m/s] with the joints at full speed. Below
a floor the damping of Nakamura and Hanafusa sets in, so that no pose demands endless speed.
Standing still keeps every limit, and from there a primal active-set method walks to the minimum:
exact, with a handful of small eliminations, and what it ends on are the limits that are active.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import NotFinite
from core.robot.limits import Limits, velocity_bounds
from core.robot.robot import Array

#: Tip speed in the worst direction below which the inverse is damped, whatever is asked [m/s].
SIGMA_FLOOR = 5e-4
#: The damping sets in earlier when more is asked, at sqrt(this * |wanted|): where the tubes line up the way
#: out turns round, and a joint that is told so late by the line would otherwise hunt at full speed [m/s].
HUNTING = 2e-4

#: Room of limits beyond single joints, where there are none.
NO_ROOM = np.zeros(0)


class Inverse(NamedTuple):
    """Joint velocities and how they were limited."""

    velocity: Array  #: (n,) [rad/s or m/s]
    sigma: Array  #: (min(m, n),) singular values of J diag(speed), largest first [m/s]
    at_bound: Array  #: (n,) -1, 0 or 1: held at its lower bound, free, at its upper
    at_row: Array  #: (m,) 1 where a row is active


def inverse(
    jacobian: Array, wanted: Array, speed: Array, lower: Array, upper: Array,
    rows: Array | None = None, room: Array = NO_ROOM, spare: Array | None = None,
) -> Inverse:  # fmt: skip
    """Joint velocity that best gives the wanted tip velocity inside the limits.

    Args:
        jacobian: (m, n) [m/rad or m/m].
        wanted: (m,) [m/s].
        speed: top speeds (n,), the joints' units of measure [rad/s or m/s].
        lower, upper: bounds (n,) that contain zero [rad/s or m/s].
        rows, room: further limits, rows (k, n) @ velocity <= room (k,), none of them below zero.
        spare: (n,) what joints that are left over should do [rad/s or m/s]; nothing when left out.

    Raises:
        NotFinite: a NaN or an infinity in what is wanted or in the Jacobian.

    """
    spare = no_spare(speed.shape[0]) if spare is None else spare
    rows = no_rows(speed.shape[0]) if rows is None else rows
    velocity, sigma, at_bound, at_row, finite = inverse_law(
        jacobian, wanted, speed, lower, upper, rows, room, spare, SIGMA_FLOOR, HUNTING
    )
    if not finite:
        _complain(jacobian, wanted)
    return Inverse(velocity, sigma, at_bound, at_row)


def inverse_at(
    limits: Limits, joints: Array, jacobian: Array, wanted: Array,
    rows: Array | None = None, room: Array = NO_ROOM,
) -> Inverse:  # fmt: skip
    """`inverse` of joints at (n,) [rad or m] that must be able to stop inside their travel."""
    rows = no_rows(joints.shape[0]) if rows is None else rows
    velocity, sigma, at_bound, at_row, finite = _inverse_at(
        limits.packed, joints, jacobian, wanted, rows, room, no_spare(joints.shape[0]), SIGMA_FLOOR, HUNTING
    )
    if not finite:
        _complain(jacobian, wanted)
    return Inverse(velocity, sigma, at_bound, at_row)


def _complain(jacobian: Array, wanted: Array) -> None:
    if not np.isfinite(wanted).all():
        raise NotFinite(f"wanted tip velocity {wanted.tolist()} m/s is not finite")
    raise NotFinite(f"Jacobian {jacobian.tolist()} is not finite")


@compiled
def _inverse_at(
    limits: Array, joints: Array, jacobian: Array, wanted: Array, rows: Array, room: Array, spare: Array,
    least_floor: float, hunting: float,
) -> tuple[Array, Array, Array, Array, bool]:  # fmt: skip
    speed = limits[2, : joints.shape[0]]
    lower, upper = velocity_bounds(joints, limits)
    return inverse_law(jacobian, wanted, speed, lower, upper, rows, room, spare, least_floor, hunting)


@cache
def no_rows(joints: int) -> Array:
    """Of limits beyond single joints, where there are none."""
    return np.empty((0, joints))


@cache
def no_spare(joints: int) -> Array:
    """What joints do that are left over, where nobody says it: nothing."""
    return np.zeros(joints)


@compiled
def inverse_law(
    jacobian: Array,
    wanted: Array,
    speed: Array,
    lower: Array,
    upper: Array,
    rows: Array,
    room: Array,
    spare: Array,
    least_floor: float,
    hunting: float,
) -> tuple[Array, Array, Array, Array, bool]:
    """In x = v / speed; limit number c is upper c for c < n, lower c - n for c < 2 n, else row c - 2 n."""
    n, m, asks = speed.shape[0], rows.shape[0], wanted.shape[0]
    scaled, total, square = np.empty((asks, n)), 0.0, 0.0
    for i in range(asks):
        total += wanted[i]
        square += wanted[i] * wanted[i]
        for j in range(n):
            scaled[i, j] = jacobian[i, j] * speed[j]
            total += scaled[i, j]
    sigma = _singular_values(scaled)
    velocity, at_bound, at_row = np.zeros(n), np.zeros(n), np.zeros(m)
    if not np.isfinite(total):
        return velocity, sigma, at_bound, at_row, False
    asked = np.sqrt(square)
    floor = max(least_floor, np.sqrt(hunting * asked))
    ratio = sigma[-1] / floor
    damping = floor * floor * (1.0 - ratio * ratio) if ratio < 1.0 else 0.0
    # More joints than rows leave a null space: a ridge far below the damping keeps it still, or has it do `spare`.
    ridge = 1e-10 * sigma[0] * sigma[0] if n > asks else 0.0
    damping += ridge
    normal, right = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        right[i] = ridge * spare[i] / speed[i]
        for k in range(asks):
            right[i] += scaled[k, i] * wanted[k]
            for j in range(n):
                normal[i, j] += scaled[k, i] * scaled[k, j]
        normal[i, i] += damping
    x, row = np.zeros(n), np.empty(n)
    working, count = np.empty(n, np.int64), 0
    system, step = np.empty((2 * n, 2 * n)), np.empty(2 * n)
    for _ in range(20 * (n + m)):
        # Minimum on the limits that are being kept: step (n) and multipliers (count).
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
            for l in range(count):  # noqa: E741 - beside k
                system[n + k, n + l] = 0.0
        if not _eliminate(system, step, n + count):
            break
        # As far along the step as the other limits allow.
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
        if block >= 0:
            working[count] = block
            count += 1
            continue
        # Let go of the limit that pulls inward the most.
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
        velocity[i] = min(max(x[i] * speed[i], lower[i]), upper[i])
    return velocity, sigma, at_bound, at_row, True


@compiled
def _limit(c: int, n: int, speed: Array, rows: Array, row: Array) -> None:
    """Left side of limit c, in x."""
    for j in range(n):
        row[j] = rows[c - 2 * n, j] * speed[j] if c >= 2 * n else 1.0 if j == c else -1.0 if j == c - n else 0.0


@compiled
def _eliminate(matrix: Array, right: Array, size: int) -> bool:
    """Gaussian elimination with row pivoting of the leading `size` rows; `right` becomes the solution."""
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
    """Of a matrix (m, n), largest first, by one-sided Jacobi rotations of its rows."""
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
    for i in range(m - 1):  # a few numbers: a library's sort takes a second to compile
        for k in range(m - 1 - i):
            if sigma[k] < sigma[k + 1]:
                sigma[k], sigma[k + 1] = sigma[k + 1], sigma[k]
    return sigma[: min(m, n)].copy()
