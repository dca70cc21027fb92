"""Search for joint positions that bring the model's tip to a point (and direction), in joint travel and tube order."""

import math
from typing import NamedTuple

import numpy as np

from core.control.velocity_ik import inverse
from core.errors import CtrError
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array

#: Largest motion of the tip in a step of a path [m]; largest motion of a joint, as its duration at full speed [s].
MAX_TIP_STEP_M, MAX_JOINT_STEP_S = 0.01, 0.5
#: Largest number of steps to a point. The steps end when the distance of the tip from the point is at most
#: `ARRIVAL_SHARE` times the tolerance.
MAX_STEPS, ARRIVAL_SHARE = 60, 0.1
#: Lever that converts an angle between two directions to a distance [m/rad]: angle times `ARROW_M`.
ARROW_M = 0.05


class Aim(NamedTuple):
    """Desired position of the tip, its load, and the desired direction if there is one."""

    point: Array  #: (3,) desired position of the tip, world frame [m]
    tolerance: float  #: largest accepted `distance` from the aim [m]
    wrench: Array  #: (6,) load on the tip [N, N m]
    direction: Array | None = None  #: (3,) unit vector of the tip's axis, world frame; None: any direction

    def errors(self, at: Solution) -> tuple[Array, float]:
        """Return the vector from the tip to the point (3,) [m], and the angle between both directions [rad]."""
        if self.direction is None:
            return self.point - at.tip, 0.0
        axis = at.rotation[:, 2]
        angle = math.atan2(float(np.linalg.norm(np.cross(axis, self.direction))), float(axis @ self.direction))
        return self.point - at.tip, angle

    def distance(self, at: Solution) -> float:
        """Return the distance from the aim [m]: the tip's distance or the angle times `ARROW_M`, if that is larger."""
        away, angle = self.errors(at)
        return max(float(np.linalg.norm(away)), ARROW_M * angle)


def move_tip(
    model: Statics, limits: Limits, order: tuple[Array, Array], at: Solution, aim: Aim
) -> tuple[Solution, float, str]:
    """Move the tip toward an aim inside the travel and the tube order; return the last pose, its distance, and a text.

    The distance is `Aim.distance` [m]. The text is empty if the pose is within the tolerance. Otherwise it names the
    limits that prevent it.
    """
    lowest, highest, speed = limits.packed[:3]
    (rows, bound), reasons = order, ""
    try:
        at = model.solve(at.joints.copy(), aim.wrench, at)
        for _ in range(MAX_STEPS):
            distance = aim.distance(at)
            if distance <= ARRIVAL_SHARE * aim.tolerance:
                break
            lower = np.maximum(lowest - at.joints, -MAX_JOINT_STEP_S * speed).clip(max=0.0)
            upper = np.minimum(highest - at.joints, MAX_JOINT_STEP_S * speed).clip(min=0.0)
            margin = (bound - rows @ at.joints).clip(min=0.0)
            jacobian, error = _step(at, aim)
            error = error * min(1.0, MAX_TIP_STEP_M / distance)
            found = inverse(jacobian, error, speed, lower, upper, rows, margin)
            active = limits.active(at.joints, found.at_bound, found.at_row)
            reasons = ", ".join(name for name in active if not name.startswith("speed"))  # steps have no speed
            if np.abs(found.velocity / speed).max() < 1e-7:
                break
            at = model.solve(np.clip(at.joints + found.velocity, lowest, highest), aim.wrench, at)
    except CtrError as failure:
        return at, aim.distance(at), str(failure)
    distance = aim.distance(at)
    return at, distance, "" if distance <= aim.tolerance else reasons or "no joint motion brings the tip nearer"


def _step(at: Solution, aim: Aim) -> tuple[Array, Array]:
    """Return the rows of the Jacobian, and the errors that they have to remove [m]."""
    away, angle = aim.errors(at)
    if aim.direction is None:
        return at.jacobian[:3], away
    x, y, axis = at.rotation.T
    # The rotation about `turn` moves the axis to the direction on the shortest path.
    turn = np.cross(axis, aim.direction)
    size = float(np.linalg.norm(turn))
    turn = turn * (angle / size) if size > 1e-12 else angle * x
    across = np.stack((x, y))
    return np.vstack((at.jacobian[:3], ARROW_M * across @ at.jacobian[3:])), np.append(away, ARROW_M * across @ turn)
