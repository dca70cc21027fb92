"""Test whether the robot keeps its shape if the tubes differ from their description by an uncertainty.

Near a snap the margin of stability falls as the square root of the distance, and its size depends on the robot. The
margin alone therefore does not show how near the snap is. This module first follows a solution to other joints. Then it
changes the tubes by the uncertainty, each parameter in the direction in which the margin falls. If Newton's method
cannot follow the shape on this path, the shape snaps.
"""

import numpy as np

from core.compiled import compiled, copy
from core.model.newton import WARM_STEP_RAD, newton
from core.model.solution import CONTACT_POSITION, STABILITY, Solution, fields
from core.model.statics import Statics
from core.model.uniqueness import is_unique
from core.robot.robot import Array, farthest_end, tube_poses, unpack

#: Relative change of a tube's parameter with which the derivative of the margin is computed.
DERIVATIVE_STEP = 2e-3
#: Largest and smallest part of a path that one solve follows; the branch ends where a smaller part would be needed.
LONGEST_PART, SHORTEST_PART = 0.5, 0.01
#: Largest change of the torsion in one part of a path [rad over the length]; a larger change means another shape.
MAX_TWIST_RAD = 1.0


def margin_of_worst_tubes(statics: Statics, near: Solution, joints: Array, uncertainty: float) -> tuple[float, float]:
    """Return the margins of stability at `joints` (n,), for the tubes as described and for the worst tubes.

    Args:
        statics: model of the robot.
        near: solution whose shape is followed to `joints`, under the load of this solution.
        joints: a valid pose [rad or m].
        uncertainty: largest relative error of curvature and stiffness of every tube.

    Returns:
        Both margins; 0 where the tubes have snapped. Infinity for the worst tubes if they cannot snap in this pose.
    """
    return _margins(*statics.compiled_arguments, near.numbers, joints, uncertainty)


@compiled
def _margins(
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], near: Array,
    joints: Array, uncertainty: float,
) -> tuple[float, float]:  # fmt: skip
    q = len(tubes)
    at, wrench, contact = near.copy(), fields(near).wrench.copy(), near[CONTACT_POSITION]
    # A proof of uniqueness for tubes of larger curvature is fast and sufficient; it also covers every stiffness.
    changed = packed.copy()
    layout = unpack(changed)
    layout.curvatures[:] *= 1.0 + 2.0 * uncertainty
    force = np.sqrt(wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2)
    moment = abs(wrench[3]) + abs(wrench[4]) + abs(wrench[5])
    beta = tube_poses(layout, joints)[1]
    if moment == 0.0 and is_unique(layout, beta, force / (1.0 - uncertainty), contact, tubes):
        return near[STABILITY], np.inf
    if not near[STABILITY] > 0.0:
        return 0.0, 0.0
    length = farthest_end(layout, beta)
    start, trial, pose = fields(near).joints.copy(), np.empty_like(near), joints.copy()
    shift, worst = np.zeros(2 * q), np.zeros(2 * q)
    # First the joints move to the requested pose, then the tubes change.
    described = 0.0
    for tubes_change in range(2):
        done, part = 0.0, LONGEST_PART
        while done < 1.0:
            to = min(1.0, done + part)
            if tubes_change:
                _change(packed, worst, to, changed)
            else:
                copy(packed, changed)
                for j in range(pose.size):
                    pose[j] = start[j] + to * (joints[j] - start[j])
            found = newton(changed, order, sublink, pose, wrench, at, contact, 1, WARM_STEP_RAD, tubes, columns, trial)
            for i in range(q):
                twist = abs(fields(trial).unknowns[i] - fields(at).unknowns[i]) if found else 0.0
                found = found and length * twist < MAX_TWIST_RAD
            if found:
                copy(trial, at)
                done, part = to, min(2.0 * part, LONGEST_PART)
            elif part > SHORTEST_PART:
                part *= 0.25
            else:
                return described, 0.0
        if tubes_change == 0:
            described = at[STABILITY]
            for k in range(2 * q):
                shift[:] = 0.0
                shift[k] = DERIVATIVE_STEP
                _change(packed, shift, 1.0, changed)
                if not newton(
                    changed, order, sublink, joints, wrench, at, contact, 1, WARM_STEP_RAD, tubes, columns, trial
                ):
                    return described, 0.0
                worst[k] = uncertainty if trial[STABILITY] < described else -uncertainty
    return described, at[STABILITY]


@compiled
def _change(packed: Array, shift: Array, part: float, changed: Array) -> None:
    """Write the robot with changed tubes to `changed`: each curvature, then each stiffness, times 1 + part x shift."""
    copy(packed, changed)
    layout = unpack(changed)
    q = layout.counts.shape[0]
    for i in range(q):
        for k in range(layout.curvatures.shape[1]):
            layout.curvatures[i, k, 0] *= 1.0 + part * shift[i]
            layout.curvatures[i, k, 1] *= 1.0 + part * shift[i]
        layout.stiffness[i, 0] *= 1.0 + part * shift[q + i]
