"""Approach to a start pose: joint velocities with which all joints arrive together."""

import numpy as np

from core.robot.robot import Array

#: Speed of the joint with the longest travel time, as a fraction of its top speed. The other joints move slower, so
#: that all joints arrive together.
SPEED_SHARE = 0.5
#: Rate at which the remaining distance to the start pose decays near the end of the approach [1/s].
APPROACH_RATE_HZ = 2.0
#: Largest remaining travel time at top speed at which a joint counts as arrived [s]: about a hundred microsteps.
ARRIVAL_TOLERANCE = 2e-3


def approach(joints: Array, start: Array, top: Array) -> Array | None:
    """Return the joint velocities (n,) [rad/s or m/s] from `joints` (n,) toward `start` (n,), or None after arrival.

    `joints` and `start` are joint positions [rad or m]; `top` (n,) are the top speeds [rad/s or m/s].
    """
    distance = (start - joints) / top
    longest = np.abs(distance).max()
    if longest <= ARRIVAL_TOLERANCE:
        return None
    return distance * min(APPROACH_RATE_HZ, SPEED_SHARE / longest) * top
