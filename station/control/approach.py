"""The way to a start pose: in joints, all of them arriving together."""

import numpy as np

from core.robot.robot import Array

#: At this part of the top speed, ending within a hundred microsteps.
SPEED = 0.5
RATE = 2.0  # [1/s]
TOLERANCE = 2e-3  # of a second at top speed


def approach(joints: Array, start: Array, top: Array) -> Array | None:
    """Velocities (n,) from `joints` (n,) toward `start` (n,) with top speeds (n,); None when there."""
    way = (start - joints) / top
    longest = np.abs(way).max()
    if longest <= TOLERANCE:
        return None
    return way * min(RATE, SPEED / longest) * top
