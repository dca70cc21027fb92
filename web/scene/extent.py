"""How much room a robot takes: for the camera, the grid and the rail. From its tubes alone, without a solution."""

from itertools import product

import numpy as np

from core.robot.limits import Limits
from core.robot.robot import Array, Robot, Tube
from web.scene.views import Bounds

STEP = 1e-3  #: along the tubes [m]
#: Around the plate, the rail and the straight tubes behind it [m].
ASIDE, BELOW = 0.022, 0.026


def translations(robot: Robot, limits: Limits) -> tuple[Array, Array]:
    """Hindmost and foremost places (q,), (q,) of the tubes' proximal ends along the plate's z [m]."""
    rear = np.array([tube.translation for tube in robot.tubes])
    front = rear.copy()
    for joint, limit in zip(robot.joints, limits.joints, strict=True):
        if joint.motion == "translation":
            rear[joint.tube], front[joint.tube] = limit.lower, limit.upper
    return rear, front


def extent(robot: Robot, limits: Limits) -> Bounds:
    """What robot and stages take, world frame: whatever the rotations, without a load."""
    rear, front = translations(robot, limits)
    places = product(*zip(rear, 0.5 * (rear + front), front, strict=True))
    reach = max(BELOW, *(_aside(robot, np.array(beta)) for beta in set(places)))
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, front, strict=True))
    lower, upper = (-reach, -reach, float(rear.min())), (reach, reach, length)
    base = robot.base
    return Bounds.around(Bounds(np.array(lower), np.array(upper)).corners @ base.rotation.T + np.array(base.position))


def _aside(robot: Robot, beta: Array) -> float:
    """How far the tip comes off the axis [m] with the tubes' proximal ends at `beta` (q,) [m], all bent the same way.

    Tubes that are turned alike take the mean of their curvatures, weighed by their stiffness.
    """
    length = max(float(start) + tube.length for tube, start in zip(robot.tubes, beta, strict=True))
    at = np.arange(0.0, max(length, STEP), STEP)
    stiffness, moment = np.full_like(at, 1e-12), np.zeros_like(at)
    for tube, start in zip(robot.tubes, beta, strict=True):
        stiffness += tube.bending_stiffness * (at < start + tube.length)
        moment += tube.bending_stiffness * _curvature(tube, at - start)
    angle = np.cumsum(moment / stiffness) * STEP
    return float(np.abs(np.sum(np.sin(angle)) * STEP))


def _curvature(tube: Tube, at: Array) -> Array:
    """Of the free tube at places from its proximal end (k,) [m]: (k,) [1/m]."""
    ends = np.cumsum([section.length for section in tube.sections])
    curvatures = np.array([np.hypot(*section.curvature) for section in tube.sections] + [0.0])
    return curvatures[np.searchsorted(ends, at, side="right")]
