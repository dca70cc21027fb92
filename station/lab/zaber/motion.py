"""The ramps of a simulated Zaber unit: the fastest motion to rest at a goal, in segments of constant acceleration."""

import math
from typing import NamedTuple


class Segment(NamedTuple):
    """Segment of a motion with constant acceleration."""

    duration: float  #: [s]
    acceleration: float  #: [microsteps/s^2]


def quickest_motion(position: float, velocity: float, goal: float, top: float, acceleration: float) -> list[Segment]:
    """Return the fastest motion to rest at `goal` [microsteps] at no more than `top` [microsteps/s]."""
    rest = position + velocity * abs(velocity) / (2.0 * acceleration)
    side = 1.0 if goal >= rest else -1.0
    distance, speed = side * (goal - position), side * velocity
    peak = min(top, math.sqrt(max(0.0, acceleration * distance + 0.5 * speed * speed)))
    ramp = acceleration if peak >= speed else -acceleration
    cruise = distance - (peak * peak - speed * speed) / (2.0 * ramp) - peak * peak / (2.0 * acceleration)
    segments = [Segment(abs(peak - speed) / acceleration, side * ramp)]
    if peak > 0.0:
        segments += [Segment(max(0.0, cruise) / peak, 0.0), Segment(peak / acceleration, -side * acceleration)]
    return segments
