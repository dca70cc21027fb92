"""Bounds of a robot for the camera, the grid and the rail, computed from tubes and limits without the model."""

from itertools import product

import numpy as np

from core.robot.limits import Limits
from core.robot.robot import Array, Robot, Tube
from web.scene.views import ViewBounds

SAMPLING_STEP = 1e-3  #: distance between the points of a tube at which its curvature is sampled [m]
#: Margins of the bounds around the plate, the rail and the straight tubes behind the plate: aside and below [m].
MARGIN_ASIDE_M, MARGIN_BELOW_M = 0.022, 0.026


def translations(robot: Robot, limits: Limits) -> tuple[Array, Array]:
    """Return the rearmost (q,) and foremost (q,) positions of the tubes' proximal ends along the plate's z axis [m]."""
    rear = np.array([tube.translation for tube in robot.tubes])
    front = rear.copy()
    for joint, limit in zip(robot.joints, limits.joints, strict=True):
        if joint.motion == "translation":
            rear[joint.tube], front[joint.tube] = limit.lower, limit.upper
    return rear, front


def extent(robot: Robot, limits: Limits) -> ViewBounds:
    """Return the bounds of robot and stages in the world frame, over all rotations of the tubes and without a load."""
    rear, front = translations(robot, limits)
    translation_sets = product(*zip(rear, 0.5 * (rear + front), front, strict=True))
    reach = max(MARGIN_BELOW_M, *(_lateral_reach(robot, np.array(beta)) for beta in set(translation_sets)))
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, front, strict=True))
    lower, upper = (-reach, -reach, float(rear.min())), (reach, reach, length)
    base = robot.base
    return ViewBounds.around(
        ViewBounds(np.array(lower), np.array(upper)).corners @ base.rotation.T + np.array(base.position)
    )


def _lateral_reach(robot: Robot, beta: Array) -> float:
    """Return the distance of the tip from the plate's axis [m] if all tubes bend in one plane.

    The proximal ends of the tubes are at `beta` (q,) [m]. The common curvature of aligned tubes is the mean of
    their curvatures, weighted by their bending stiffness.
    """
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, beta, strict=True))
    at = np.arange(0.0, max(length, SAMPLING_STEP), SAMPLING_STEP)
    stiffness, moment = np.full_like(at, 1e-12), np.zeros_like(at)
    for tube, start in zip(robot.tubes, beta, strict=True):
        stiffness += tube.bending_stiffness * (at < start + tube.length)
        moment += tube.bending_stiffness * _curvature(tube, at - start)
    angle = np.cumsum(moment / stiffness) * SAMPLING_STEP
    return float(np.abs(np.sum(np.sin(angle)) * SAMPLING_STEP))


def _curvature(tube: Tube, at: Array) -> Array:
    """Return the curvature (k,) [1/m] of the unstressed tube at distances `at` (k,) [m] from its proximal end."""
    ends = np.cumsum([section.length for section in tube.sections])
    curvatures = np.array([np.hypot(*section.curvature) for section in tube.sections] + [0.0])
    return curvatures[np.searchsorted(ends, at, side="right")]
