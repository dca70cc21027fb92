"""A setpoint that goes after a moving goal with bounded speed and acceleration, and comes to rest without one.

On the goal it has the goal's velocity and no lag. Away from it it closes in as fast as it can stop: with e the way that
is left and b the part of the acceleration a that braking is planned with, it goes at

    v = v_goal + e / |e| c(|e|),    c(s) = K s  up to s = b a / K^2,  sqrt(2 b a (s - b a / (2 K^2)))  beyond,

a first-order approach near the goal that meets the braking from further off with one slope. The rest of the
acceleration is for what the goal does meanwhile.
"""

import math
from dataclasses import dataclass

import numpy as np

from core.compiled import compiled
from core.control.predictor import Place
from core.errors import DescriptionError
from core.robot.robot import Array


@dataclass(frozen=True)
class Pursuit:
    """How a setpoint may move."""

    max_speed: float  #: [m/s]
    max_acceleration: float  #: [m/s^2]
    rate: float = 5.0  #: K, at which what is left of the way shrinks near the goal [1/s]
    braking: float = 0.5  #: b, part of the acceleration
    reach: float = math.inf  #: from the origin, beyond which it does not go [m]

    def __post_init__(self) -> None:
        for name, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s^2"), ("rate", "1/s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"pursuit: {name} {value:g} {unit} must be finite and greater than 0")
        if not 0.0 < self.braking <= 1.0:
            raise DescriptionError(f"pursuit: braking {self.braking:g} must be greater than 0 and at most 1")
        if not self.reach > 0.0:
            raise DescriptionError(f"pursuit: reach {self.reach:g} m must be greater than 0")

    def step(self, last: Place, goal: Place | None, period: float) -> Place:
        """Where the setpoint is `period` [s] after `last`, when `goal` is where it should be; None: it should rest."""
        new = Place(np.empty(3), np.empty(3))
        aim = goal or Place(last.position, _STILL)
        _step(
            *last, *aim, period, self.max_speed, self.max_acceleration, self.rate, self.braking, self.reach, *new
        )  # fmt: skip
        return new


_STILL = np.zeros(3)


@compiled
def _step(
    position: Array, velocity: Array, goal: Array, goal_velocity: Array, period: float, max_speed: float,
    max_acceleration: float, rate: float, braking: float, reach: float, new_position: Array, new_velocity: Array,
) -> None:  # fmt: skip
    """`Pursuit.step`, into the last two."""
    deceleration = braking * max_acceleration
    for i in range(3):
        new_velocity[i] = goal[i] - position[i]
    left = _length(new_velocity)
    closing = _approach(left, rate, deceleration) / left if left > 0.0 else 0.0
    for i in range(3):
        new_velocity[i] = goal_velocity[i] + closing * new_velocity[i]
    _shorten(new_velocity, max_speed)
    # Away from the origin no faster than it can stop before the bound.
    away = _length(position)
    if away > 0.0 and reach < math.inf:
        outward = 0.0
        for i in range(3):
            outward += new_velocity[i] * position[i] / away
        too_fast = max(0.0, outward - _approach(reach - away, rate, deceleration))
        for i in range(3):
            new_velocity[i] -= too_fast * position[i] / away
    for i in range(3):
        new_velocity[i] -= velocity[i]
    _shorten(new_velocity, max_acceleration * period)
    for i in range(3):
        new_velocity[i] += velocity[i]
        new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])


@compiled
def _approach(left: float, rate: float, deceleration: float) -> float:
    """Speed c at which a way [m] can still be ended with that deceleration [m/s]; a way gone too far is gone back."""
    near = deceleration / rate**2
    return rate * left if left <= near else math.sqrt(2.0 * deceleration * (left - 0.5 * near))


@compiled
def _shorten(vector: Array, most: float) -> None:
    length = _length(vector)
    if length > most:
        for i in range(3):
            vector[i] *= most / length


@compiled
def _length(vector: Array) -> float:
    return math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
