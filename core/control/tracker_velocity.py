"""Tip velocity that the joints do not cause, from the tracker alone: X'_meas - J(q, w) q' of eqs. (28) and (29).

This velocity is the difference quotient of two tracker frames, minus the tip motion that the joints cause between them.
The velocity is not filtered and therefore contains the noise of two frames 25 ms apart, as the paper warns.
"""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array


class TrackerVelocity(NamedTuple):
    """Tip velocity from the last two tracker frames, and the state that the next frame needs."""

    velocity: Array  #: (3,) tip velocity that the joints do not cause, X'_meas - J q' [m/s]
    travel: Array  #: (3,) tip displacement that the joints caused since the newest frame [m]
    since: float  #: time since the newest frame was measured [s]


#: State before two tracker frames have arrived: zero velocity.
NO_FRAMES = TrackerVelocity(np.zeros(3), np.zeros(3), 0.0)


def differentiate(
    last: TrackerVelocity, by_joints: Array, before: Array, frame: Array | None, age: float, period: float
) -> TrackerVelocity:
    """Return the velocity from tracker frames one tick later.

    Args:
        last: state of the last tick.
        by_joints: tip velocity (3,) that the joints cause, J(q, w) q' [m/s].
        before: tip (3,) in the newest frame so far [m].
        frame: tip (3,) in a new frame [m]; None: no new frame.
        age: time since the new frame was measured [s].
        period: time between two ticks [s].
    """
    since, travel = last.since + period, last.travel + period * by_joints
    span = since - age
    if frame is None or span <= 0.0:  # no frame arrived, or the frame is not newer than the last one
        return TrackerVelocity(last.velocity, travel, since)
    return TrackerVelocity((frame - before - travel) / span, np.zeros(3), age)
