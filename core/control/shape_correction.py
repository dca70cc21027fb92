"""Correction of the points along the tubes when the observed tip differs from the model's tip.

The offset of the tip has several causes: stiffness and curvature of each tube differ from the robot's description, and
the estimated force has an error. Each cause has a standard deviation; J_i is the derivative of point i by the causes.
The most likely causes of an offset d of the tip move point i by

    W_i d = J_i G d + s_i^2 (1 - J_tip G) d,    G = P J_tip^T (J_tip P J_tip^T + R)^-1,

where P contains the variances of the causes, R is the variance of the observed tip, and s_i is the point's share of the
length. The second term distributes the part of the offset that the causes do not explain.

The derivatives are difference quotients of solved shapes. They change slowly with the pose, so each tracker frame
updates only those of one cause.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.model.backbone import centre_line, tip_point
from core.model.newton import CONTROL_STEP_RAD, newton
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Tube

#: Step sizes of the difference quotients: fraction of stiffness or curvature, and force [N].
TUBE_STEP, FORCE_STEP_N = 0.01, 0.01
#: Standard deviation of the force in each axis: on a bench with force sensors, and on one without [N].
FORCE_ERROR_N, UNKNOWN_FORCE_N = 0.01, 0.25


class Cause(NamedTuple):
    """A cause of the model's error."""

    statics: Statics  #: model in which this cause is changed by `step`
    force: Array  #: (3,) change of the force on the tip [N]
    step: float  #: size of the change
    deviation: float  #: standard deviation of this cause, in the unit of `step`


class ShapeCorrection(NamedTuple):
    """Displacement of the points along the tubes for an offset of the observed tip."""

    weights: Array  #: (m, 3, 3) displacement of each point per offset of the tip
    influence: Array  #: (m, 3, p) derivative of each point by each cause
    newest: int  #: index of the cause whose derivatives were computed last


def error_causes(statics: Statics, tube_error: float, force_error: float) -> tuple[Cause, ...]:
    """Return the causes of the model's error: curvature and stiffness of each tube, and each component of the force.

    Args:
        statics: model of the robot.
        tube_error: standard deviation of each tube's curvature and stiffness, as a fraction of their values.
        force_error: standard deviation of the force on the tip in each axis [N].
    """
    found: list[Cause] = []
    for number, tube in enumerate(statics.robot.tubes):
        for changed in (_with_curvature(tube, 1.0 + TUBE_STEP), _with_stiffness(tube, 1.0 + TUBE_STEP)):
            tubes = (*statics.robot.tubes[:number], changed, *statics.robot.tubes[number + 1 :])
            model = replace(statics, robot=replace(statics.robot, tubes=tubes))
            found.append(Cause(model, np.zeros(3), TUBE_STEP, tube_error))
    found += [Cause(statics, force, FORCE_STEP_N, force_error) for force in FORCE_STEP_N * np.eye(3)]
    return tuple(found)


def start_correction(statics: Statics, causes: Sequence[Cause], at: Solution, tip_noise: float) -> ShapeCorrection:
    """Return the correction of a solved shape; `tip_noise` is the observed tip's standard deviation [m]."""
    nominal, shares = centre_line(statics, at)
    influence = np.stack([_derivative(cause, at, nominal, np.zeros_like(nominal)) for cause in causes], axis=2)
    return ShapeCorrection(
        _weights(causes, influence, shares, tip_point(statics, at), tip_noise), influence, len(causes) - 1
    )


def update_correction(
    statics: Statics, causes: Sequence[Cause], last: ShapeCorrection, at: Solution, tip_noise: float
) -> ShapeCorrection:
    """Return the correction for a solved shape, with updated derivatives of the next cause."""
    nominal, shares = centre_line(statics, at)
    influence, number = last.influence.copy(), (last.newest + 1) % len(causes)
    influence[:, :, number] = _derivative(causes[number], at, nominal, influence[:, :, number])
    return ShapeCorrection(_weights(causes, influence, shares, tip_point(statics, at), tip_noise), influence, number)


def _derivative(cause: Cause, at: Solution, nominal: Array, last: Array) -> Array:
    """Return the derivative (m, 3) of the points by a cause; `last` if the changed model has no shape nearby."""
    packed, order, sublink, tubes, columns = cause.statics.compiled_arguments
    wrench, found = at.wrench.copy(), Solution(np.empty_like(at.numbers))
    wrench[:3] += cause.force
    solved = newton(
        packed, order, sublink, at.joints, wrench, at.numbers, math.inf, 1, CONTROL_STEP_RAD, tubes, columns,
        found.numbers,
    )  # fmt: skip
    return (centre_line(cause.statics, found)[0] - nominal) / cause.step if solved else last


def _weights(causes: Sequence[Cause], influence: Array, shares: Array, at_tip: int, tip_noise: float) -> Array:
    """Return the weights (m, 3, 3) of a correction; `at_tip` is the index of the tip's point."""
    tip, variances = influence[at_tip], np.array([cause.deviation**2 for cause in causes])
    spread = variances[:, None] * tip.T
    variance: Array = tip @ spread + tip_noise**2 * np.eye(3)
    gain = np.transpose(np.asarray(np.linalg.solve(variance, spread.T), dtype=np.float64))
    return influence @ gain + shares[:, None, None] ** 2 * (np.eye(3) - tip @ gain)


def _with_curvature(tube: Tube, factor: float) -> Tube:
    """Return a tube whose curvature is multiplied by a factor."""
    scaled = (replace(one, curvature=tuple(factor * u for u in one.curvature)) for one in tube.sections)
    return replace(tube, sections=tuple(scaled))


def _with_stiffness(tube: Tube, factor: float) -> Tube:
    """Return a tube whose bending and torsional stiffness are multiplied by a factor."""
    torsional = None if tube.torsional_stiffness is None else factor * tube.torsional_stiffness
    return replace(tube, bending_stiffness=factor * tube.bending_stiffness, torsional_stiffness=torsional)
