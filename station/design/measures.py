"""What tubes are judged by at a pose: how quickly the tip moves at worst, and how far a load bends them at most."""

import numpy as np

from core.robot.robot import Array


def dexterity(jacobian: Array, speed: Array) -> Array:
    """The tip's speed in the worst direction with the joints at full speed (k,) [m/s].

    The smallest singular value of the position rows of J diag(speed): so radians and metres compare.

    Args:
        jacobian: (k, 6, n) [m/rad or m/m].
        speed: of the joints (n,) [rad/s or m/s].

    """
    if jacobian.shape[2] < 3:
        return np.zeros(len(jacobian))  # in some direction it does not move at all
    return np.asarray(np.linalg.svd(jacobian[:, :3] * speed, compute_uv=False)[:, 2], np.float64)


def stiffness(compliance: Array) -> Array:
    """Force at the tip over its way in the softest direction (k,) [N/m], of compliances (k, 6, 6)."""
    return 1.0 / np.asarray(np.linalg.svd(compliance[:, :3, :3], compute_uv=False)[:, 0], np.float64)
