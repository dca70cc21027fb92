"""Quality measures of a robot at a pose: dexterity and stiffness of its tip in the worst direction."""

import numpy as np

from core.robot.robot import Array


def dexterity(jacobian: Array, speed: Array) -> Array:
    """Return the dexterity (k,) [m/s]: speed of the tip in its slowest direction while the joints move at full speed.

    The dexterity is the smallest singular value of the position rows of J diag(speed). Scaling the Jacobian J with the
    top speeds makes joints in radians and in metres comparable.

    Args:
        jacobian: Jacobians of the tip at k poses (k, 6, n) [m/rad or m/m].
        speed: top speed of the joints (n,) [rad/s or m/s].

    """
    if jacobian.shape[2] < 3:
        return np.zeros(len(jacobian))  # two joints cannot move the tip in all three directions
    return np.asarray(np.linalg.svd(jacobian[:, :3] * speed, compute_uv=False)[:, 2], np.float64)


def stiffness(compliance: Array) -> Array:
    """Return the tip's stiffness in its softest direction at k poses (k,) [N/m], from compliances (k, 6, 6)."""
    return 1.0 / np.asarray(np.linalg.svd(compliance[:, :3, :3], compute_uv=False)[:, 0], np.float64)
