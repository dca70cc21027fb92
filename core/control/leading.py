"""A tip that is led from outside: wishes come when they come, the setpoint moves with bounded speed and acceleration.

Toward a place that itself moves with the velocity v_w the setpoint goes at

    v = v_w + e / |e| c(|e|),    c(s) = K s  up to s = a / K^2,  sqrt(2 a (s - a / (2 K^2)))  beyond,

e being the way that is left: the fastest approach that a deceleration a can still end there, and near the
place a first-order one (the two meet with one slope). The change of v in a period is at most a times the period.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.trajectories import Setpoint
from core.errors import DescriptionError
from core.robot.robot import Array

#: K, with which the last of the way is gone [1/s].
CLOSING = 20.0
#: Part of the acceleration that braking is planned with; the rest is for what the wish itself does.
PLANNED = 0.8


class Wish(NamedTuple):
    """What was asked for last."""

    place: Array | None  #: (3,) from the start tip [m]; None: a velocity was asked for
    velocity: Array  #: (3,) asked for, or that of the places [m/s]
    asked: float  #: when it came [s]
    goes_on: float  #: for so long after that it goes on by its velocity [s]


@dataclass(frozen=True)
class Bounds:
    """What a led tip keeps to, whatever is asked for."""

    speed: float = 0.02  #: [m/s]
    acceleration: float = 0.1  #: [m/s^2]
    reach: float = 0.05  #: from the start tip [m]

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("speed", self.speed, "m/s"), ("acceleration", self.acceleration, "m/s^2"), ("reach", self.reach, "m")
        ):  # fmt: skip
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"led tip: {name} {value:g} {unit} must be finite and greater than 0")


class LedTip:
    """The setpoint of a led tip, from rest at the start."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._position, self._velocity = np.zeros(3), np.zeros(3)

    @property
    def speed(self) -> float:
        """At which the setpoint moves [m/s]."""
        return float(np.linalg.norm(self._velocity))

    def advance(self, now: float, wish: Wish | None, period: float) -> Setpoint:
        """The setpoint one `period` [s] on; without a wish it comes to rest where that is soonest."""
        place, wanted = self._position, np.zeros(3)
        if wish is not None:
            since = now - wish.asked
            goes_on = since < wish.goes_on
            if goes_on:
                wanted = wish.velocity
            if wish.place is not None:
                place = wish.place + min(max(since, 0.0), wish.goes_on) * wish.velocity
        _advance(self._position, self._velocity, place, wanted, *_numbers(self._bounds), period)
        return Setpoint(self._position.copy(), self._velocity.copy())


def _numbers(bounds: Bounds) -> tuple[float, float, float]:
    return bounds.speed, bounds.acceleration, bounds.reach


@compiled
def _advance(
    position: Array, velocity: Array, place: Array, wanted: Array, speed: float, acceleration: float, reach: float,
    period: float,
) -> None:  # fmt: skip
    """Move a position (3,) [m] and its velocity (3,) [m/s] on by one period [s], in place."""
    braking = PLANNED * acceleration
    left = math.sqrt((place[0] - position[0]) ** 2 + (place[1] - position[1]) ** 2 + (place[2] - position[2]) ** 2)
    closing = CLOSING
    if left > braking / CLOSING**2:
        closing = math.sqrt(2.0 * braking * (left - 0.5 * braking / CLOSING**2)) / left
    next_ = np.empty(3)
    for k in range(3):
        next_[k] = wanted[k] + closing * (place[k] - position[k])
    _shorten(next_, speed)
    # Away from the start no faster than it can stop before the bound.
    away = math.sqrt(position[0] ** 2 + position[1] ** 2 + position[2] ** 2)
    if away > 0.0:
        outward = (next_[0] * position[0] + next_[1] * position[1] + next_[2] * position[2]) / away
        most = math.sqrt(2.0 * braking * max(0.0, reach - away))
        # As near to the bound, the last of the way as everywhere.
        most = min(most, CLOSING * max(0.0, reach - away))
        if outward > most:
            for k in range(3):
                next_[k] -= (outward - most) * position[k] / away
    for k in range(3):
        next_[k] -= velocity[k]
    _shorten(next_, acceleration * period)
    for k in range(3):
        velocity[k] += next_[k]
        position[k] += period * velocity[k]


@compiled
def _shorten(vector: Array, most: float) -> None:
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length > most:
        for k in range(3):
            vector[k] *= most / length
