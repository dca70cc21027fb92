"""Zeros of the base sensors: their drift since the tare, estimated while the robot moves.

The zero of a sensor is its reading without load. A drifting zero looks like a load that changes slowly. Three residuals
distinguish drift from load. Let F and M be the total force and moment after subtraction of the estimated zeros, r the
model's loaded tip, C the compliance, b the observer's bias, and f the force under which the model's tip was computed:

    b + C (f - F) = -C T_F e + model error
    M - r x F = (T_M - r x T_F) e + lever error
    n^T F = n^T T_F e + load along n

The vector e contains the errors of the estimated zeros, and T_F and T_M sum them like wrenches. The first residual is
small for a true load: a measured force that does not move the tip is drift. The second residual is zero for a true load
at the tip. Both residuals hardly show a force along the direction n in which the tip is stiffest, which is nearly the
robot's axis. The third residual therefore assumes that a load of `LOAD_N` along n lasts for `LOAD_S`. A constant load
along n becomes part of the zeros after about a quarter of an hour. This force remains known as `assumed`: it may be a
load. A motion that controls the force omits the third residual, because the loop would replace each force that it
takes away by a true one.

Each zero rotates with its tube, so a motion makes the zeros of several sensors distinguishable. A Kalman filter
estimates all zeros as random walks. The model error is nearly the same in successive frames, so the filter takes the
variance of a residual per `MODEL_S` and not per frame.
"""

import math
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.tip_force import SensorErrors
from core.model.solution import Solution
from core.robot.robot import Array, Robot, sensor_poses, unpack

#: Time during which errors of model and lever stay similar [s]: three periods of a usual motion.
MODEL_S = 60.0
#: Until this time after the tare, a zero's variance grows as with a steady drift; then as in a random walk [s].
WALK_S = 900.0
#: Assumed standard deviation [N] and duration [s] of a load along the robot's axis.
LOAD_N, LOAD_S = 0.1, 60.0


class SensorZeros(NamedTuple):
    """Estimated zeros of the base sensors relative to the tare."""

    values: Array  #: (s, 6) zeros, each in the axes of its sensor [N, N m]
    covariance: Array  #: (6 s, 6 s) covariance of the errors of `values`
    since: float  #: time of the latest update, counted from the tare [s]
    assumed: Array  #: (3,) force that the third residual has moved into the zeros, world frame [N]
    deviation: float = 0.0  #: largest standard deviation of the zeros' sum of forces, of all directions [N]


def start_zeros(count: int) -> SensorZeros:
    """Return the zeros of `count` sensors after a tare."""
    return SensorZeros(np.zeros((count, 6)), np.zeros((6 * count, 6 * count)), 0.0, np.zeros(3))


def update_zeros(
    last: SensorZeros, errors: SensorErrors, robot: Robot, loaded: Solution,
    load: Array, bias: Array, force: Array, misfit: float, now: float, *, controlled: bool = False,
) -> SensorZeros:  # fmt: skip
    """Return the zeros after a tracker frame.

    Args:
        last: zeros of the previous frame; `load` was computed with them.
        errors: errors of the sensors and of the model.
        robot: the robot.
        loaded: model under the estimated load.
        load: total force and moment (6,) about the plate's origin, in world axes, of the sensors minus `last`.
        bias: measured tip minus the model's tip under `force` (3,) [m].
        force: force at the tip (3,) [N].
        misfit: chi square of the moment mismatch over `FITS`. Above 1 the load does not act at the tip. The residuals
            assume a load at the tip, so they then lose their weight.
        now: time since the tare [s].
        controlled: the motion controls the force, so the third residual is omitted.

    """
    values, covariance, assumed = last.values.copy(), last.covariance.copy(), last.assumed.copy()
    _update(
        robot.packed, loaded.joints, loaded.tip, loaded.compliance, load, bias, force,
        2.0 * min(now, WALK_S) * errors.drift, MODEL_S * errors.lever**2,
        MODEL_S * (errors.gain * errors.moment_range) ** 2, math.inf if controlled else LOAD_S * LOAD_N**2,
        max(misfit, 1.0) ** 2, now - last.since,
        values, covariance, assumed,
    )  # fmt: skip
    return SensorZeros(values, covariance, now, assumed, _deviation(robot, loaded.joints, covariance))


def _deviation(robot: Robot, joints: Array, covariance: Array) -> float:
    """Return the largest standard deviation of the sum of the sensors' zero forces [N]."""
    alpha, _ = sensor_poses(robot.layout, joints)
    turns = np.zeros((3, 6 * len(alpha)))
    turns[0, ::6], turns[0, 1::6] = np.cos(alpha), -np.sin(alpha)
    turns[1, ::6], turns[1, 1::6] = np.sin(alpha), np.cos(alpha)
    turns[2, 2::6] = 1.0
    return math.sqrt(max(float(np.linalg.eigvalsh(turns @ covariance @ turns.T)[-1]), 0.0))


@compiled
def _update(
    packed: Array, joints: Array, tip: Array, compliance: Array, load: Array, bias: Array, force: Array,
    walk: Array, lever: float, moment: float, held: float, doubt: float, elapsed: float,
    values: Array, covariance: Array, assumed: Array,
) -> None:  # fmt: skip
    """Compute `update_zeros` in place; `walk`, `lever`, `moment` and `held` are densities."""
    layout = unpack(packed)
    alpha, beta = sensor_poses(layout, joints)
    q, base = alpha.shape[0], layout.base
    x, y, z = tip[0] - base[9], tip[1] - base[10], tip[2] - base[11]
    residual, rows, variances = np.zeros(7), np.zeros((7, 6 * q)), np.zeros(7)
    residual[3] = load[3] - (y * load[2] - z * load[1])
    residual[4] = load[4] - (z * load[0] - x * load[2])
    residual[5] = load[5] - (x * load[1] - y * load[0])
    for k in range(3):
        residual[k] = bias[k]
        for j in range(3):
            residual[k] += compliance[k, j] * (force[j] - load[j])
        squared = force[0] * force[0] + force[1] * force[1] + force[2] * force[2]
        variances[k] = doubt * lever / elapsed
        variances[3 + k] = doubt * (moment + lever * squared) / elapsed
    stiff = _stiffest(compliance)
    residual[6] = stiff[0] * load[0] + stiff[1] * load[1] + stiff[2] * load[2]
    variances[6] = held / elapsed
    axis = np.empty((3, 3))
    for i in range(q):
        c, s = math.cos(alpha[i]), math.sin(alpha[i])
        for k in range(3):  # the sensor's axes in the world, one per row
            axis[0, k] = c * base[3 * k] + s * base[3 * k + 1]
            axis[1, k] = c * base[3 * k + 1] - s * base[3 * k]
            axis[2, k] = base[3 * k + 2]
        ox, oy, oz = beta[i] * axis[2, 0] - x, beta[i] * axis[2, 1] - y, beta[i] * axis[2, 2] - z
        drift = walk[min(i, walk.shape[0] - 1)]
        for m in range(3):
            u, at = axis[m], 6 * i + m
            for k in range(3):
                rows[k, at] = -(compliance[k, 0] * u[0] + compliance[k, 1] * u[1] + compliance[k, 2] * u[2])
                rows[3 + k, at + 3] = u[k]
            rows[6, at] = stiff[0] * u[0] + stiff[1] * u[1] + stiff[2] * u[2]
            rows[3, at], rows[4, at], rows[5, at] = (
                oy * u[2] - oz * u[1],
                oz * u[0] - ox * u[2],
                ox * u[1] - oy * u[0],
            )
            covariance[at, at] += drift[0] * elapsed
            covariance[at + 3, at + 3] += drift[1] * elapsed
    n = 6 * q
    error, gain = np.zeros(n), np.empty(n)
    for row in range(7):  # update with one residual after the other
        expected, spread, surprise = variances[row], 0.0, residual[row]
        for a in range(n):
            gain[a] = 0.0
            for b in range(n):
                gain[a] += covariance[a, b] * rows[row, b]
            expected += rows[row, a] * gain[a]
            spread += rows[row, a] * gain[a]
            surprise -= rows[row, a] * error[a]
        for a in range(n):
            error[a] += gain[a] * surprise / expected
            for b in range(n):
                covariance[a, b] -= gain[a] * gain[b] / expected
        if row == 6:
            for k in range(3):
                assumed[k] += stiff[k] * spread * surprise / expected
    for i in range(q):
        for m in range(6):
            values[i, m] += error[6 * i + m]


@compiled
def _stiffest(c: Array) -> Array:
    """Return the unit vector (3,) along which a force moves the tip least: the longest cross product of two rows of C.

    The cross products are the columns of the adjugate, which the smallest eigenvalue of C dominates.
    """
    best, longest = np.zeros(3), 0.0
    for i in range(3):
        a, b = c[(i + 1) % 3], c[(i + 2) % 3]
        x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        length = math.sqrt(x * x + y * y + z * z)
        if length > longest:
            longest = length
            best[0], best[1], best[2] = x / length, y / length, z / length
    return best
