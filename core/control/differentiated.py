"""What moves the tip besides the joints, from the tracker alone: X'_meas - J(q, w) q' of eqs. (28) and (29).

From frame to frame, so the joints' part is what they did between two frames. Nothing is filtered: a frame's noise over
a frame's 25 ms is what the paper warns of.
"""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array


class Differentiated(NamedTuple):
    """What two frames show, until the next one comes."""

    velocity: Array  #: (3,) X'_meas - J q' [m/s]
    way: Array  #: (3,) that the joints have moved the tip since the newest frame came [m]
    since: float  #: that frame was taken so long ago [s]


#: Before there are two frames.
AT_REST = Differentiated(np.zeros(3), np.zeros(3), 0.0)


def differentiate(
    last: Differentiated, by_joints: Array, before: Array, frame: Array | None, age: float, period: float
) -> Differentiated:
    """One period on.

    Args:
        last: as of the last tick.
        by_joints: (3,) J(q, w) q' [m/s].
        before: (3,) the newest frame until now [m].
        frame: (3,) one that has just arrived [m], or None.
        age: the time since that was taken [s].
        period: of a tick [s].
    """
    since, way = last.since + period, last.way + period * by_joints
    span = since - age
    if frame is None or span <= 0.0:  # none, or one that is no newer
        return Differentiated(last.velocity, way, since)
    return Differentiated((frame - before - way) / span, np.zeros(3), age)
