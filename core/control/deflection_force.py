"""Force at the tip from its deflection: the force that explains the tracker's tip through the model's compliance.

The robot bends under a load also on a bench without force sensors. The observer gives the present tip X. The observer's
bias at the start of the motion, where the tip carries no load, is the error b_0 of the unloaded model. The force f
explains the remaining difference

    X - b_0 = F(q, f),    F(q, f + df) = F(q, f) + C(q, f) df.

Let s^2 be the variance of X - b_0 in each axis, and N(0, `LARGEST_FORCE_N`^2) the prior of the force in each axis. Then
the force step and the covariance are

    A = C^T C / s^2 + I / LARGEST_FORCE_N^2,    df = A^-1 (C^T r / s^2 - f / LARGEST_FORCE_N^2),    P = A^-1,

where r is the residual X - b_0 - F(q, f). Each tracker frame executes one step. The variance s^2 has three parts: the
variance of the observer's bias, `MODEL_ERROR_M`^2, and a part for the tubes' stiffness and curvature in proportion to
the square of the deflection. Filter and delay are those of the observer. Along the tubes the compliance C is only
0.1 mm/N: there the covariance approaches LARGEST_FORCE_N^2, and the estimate is close to zero. Sources:
D. C. Rucker and R. J. Webster, "Deflection-based force sensing for continuum robots", ICRA 2011; K. Xu and N. Simaan,
T-RO 24(3), 2008, for the singular values of C.
"""

import math
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.observer import ObserverState
from core.control.tip_force import invert_symmetric
from core.errors import CtrError
from core.model.solution import Solution, pure_force
from core.model.statics import Statics
from core.robot.robot import Array

#: Standard deviation, in each axis, by which the error of the unloaded model changes between the start of a motion and
#: a point on its path [m].
MODEL_ERROR_M = 0.2e-3
#: Standard deviation of the model's deflection as a fraction of the deflection: for tubes whose stiffness and curvature
#: are within 8 % of the robot file, and after `calibrate tubes`.
TUBE_ERROR, CALIBRATED_TUBE_ERROR = 0.05, 0.01
#: Standard deviation of the force's prior in each axis [N]. Across the tubes (30 mm/N) the prior has no effect. Along
#: the tubes (0.1 mm/N) a larger value would only pass more of the tracker's noise.
LARGEST_FORCE_N = 0.25
#: Largest change of the force by one tracker frame [N], because the compliance C changes with the force.
LARGEST_STEP_N = 0.2


class DeflectionForce(NamedTuple):
    """Force at the tip after a tracker frame, and the state for the next frame."""

    force: Array  #: (3,) force at the tip, world frame [N]
    covariance: Array  #: (6,) covariance of the force: xx, xy, xz, yy, yz, zz [N^2]
    reference: Array  #: (3,) bias of the model without load [m]
    solution: Solution  #: solved model under an earlier force, from which the next solve starts


def start_deflection(unloaded: Solution, reference: Array) -> DeflectionForce:
    """Return the estimate without load; `reference` (3,) is measured minus model's tip at the present pose [m]."""
    return DeflectionForce(np.zeros(3), _unknown(), reference, unloaded)


def update_deflection(
    statics: Statics, last: DeflectionForce, joints: Array, unloaded: Solution, observed: ObserverState,
    residual: Array, tube_error: float = TUBE_ERROR,
) -> DeflectionForce:  # fmt: skip
    """Return the estimate after a tracker frame that the observer has used or rejected.

    Where the model has no shape under the estimated force, the force becomes zero with the covariance of an unknown
    force, so that a wrong frame never stops the controller.

    Args:
        statics: model of the robot.
        last: estimate of the last frame.
        joints: measured joint positions (n,) [rad or m].
        unloaded: solved model without load in this tick.
        observed: state of the tip observer in this tick.
        residual: learned residual (3,) in the model's tip of this tick; the solution here does not contain it [m].
        tube_error: standard deviation of the model's deflection relative to the deflection.

    """
    try:
        solution = statics.solve(joints, pure_force(last.force), last.solution)
    except CtrError:
        return last._replace(force=np.zeros(3), covariance=_unknown())
    force, covariance = last.force.copy(), np.empty(6)
    tip = observed.tip - last.reference
    by_tubes = tube_error * math.dist(tip, unloaded.tip)
    variance = observed.covariance[0] + MODEL_ERROR_M**2 + by_tubes * by_tubes
    _step(solution.compliance, tip - residual - solution.tip, variance, force, covariance)
    return DeflectionForce(force, covariance, last.reference, solution)


@compiled
def _step(compliance: Array, residual: Array, variance: float, force: Array, covariance: Array) -> None:
    """Execute one step: change the force (3,) in place and write its covariance (6,)."""
    c, prior = compliance, 1.0 / LARGEST_FORCE_N**2
    information, right = np.empty(6), np.empty(3)
    at = 0
    for i in range(3):
        right[i] = -prior * force[i]
        for k in range(3):
            right[i] += c[k, i] * residual[k] / variance
        for j in range(i, 3):
            information[at] = prior if i == j else 0.0
            for k in range(3):
                information[at] += c[k, i] * c[k, j] / variance
            at += 1
    a = information
    invert_symmetric(a[0], a[1], a[2], a[3], a[4], a[5], covariance)
    p = covariance
    x = p[0] * right[0] + p[1] * right[1] + p[2] * right[2]
    y = p[1] * right[0] + p[3] * right[1] + p[4] * right[2]
    z = p[2] * right[0] + p[4] * right[1] + p[5] * right[2]
    part = LARGEST_STEP_N / max(LARGEST_STEP_N, math.sqrt(x * x + y * y + z * z))
    force[0], force[1], force[2] = force[0] + part * x, force[1] + part * y, force[2] + part * z


def _unknown() -> Array:
    return np.array((1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) * LARGEST_FORCE_N**2
