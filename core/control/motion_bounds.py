"""A setpoint that follows a moving goal with bounded speed and acceleration; without a goal the setpoint stops.

At the goal, the setpoint has the goal's velocity and no lag. Elsewhere the setpoint approaches the goal at the speed
from which it can still stop at the goal. The setpoint's velocity, with the remaining displacement e, the approach rate
K, and the fraction b of the largest acceleration a that is planned for braking, is

    v = v_goal + e / |e| c(|e|),    c(s) = K s  up to s = b a / K^2,  sqrt(2 b a (s - b a / (2 K^2)))  beyond,

Near the goal the distance decays exponentially; from farther away the setpoint brakes with constant deceleration. The
slope of the speed c(s) is continuous where the two formulas meet. The rest of the acceleration is reserved for the
motion of the goal.
"""

import math
from dataclasses import dataclass

import numpy as np

from core.compiled import compiled
from core.control.predictor import TargetState
from core.errors import DescriptionError
from core.robot.robot import Array


@dataclass(frozen=True)
class MotionBounds:
    """Bounds on speed, acceleration and position of a setpoint."""

    max_speed: float  #: largest speed of the setpoint [m/s]
    max_acceleration: float  #: largest acceleration of the setpoint [m/s^2]
    rate: float = 5.0  #: rate K at which the remaining distance decays near the goal [1/s]
    braking: float = 0.5  #: fraction b of the acceleration that is planned for braking
    reach: float = math.inf  #: largest distance of the setpoint from the origin [m]

    def __post_init__(self) -> None:
        for name, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s^2"), ("rate", "1/s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"pursuit: {name} {value:g} {unit} must be finite and greater than 0")
        if not 0.0 < self.braking <= 1.0:
            raise DescriptionError(f"pursuit: braking {self.braking:g} must be greater than 0 and at most 1")
        if not self.reach > 0.0:
            raise DescriptionError(f"pursuit: reach {self.reach:g} m must be greater than 0")

    def step(self, last: TargetState, goal: TargetState | None, period: float) -> TargetState:
        """Return the setpoint one `period` [s] after `last` on its path to `goal`; without a goal it stops."""
        new = TargetState(np.empty(3), np.empty(3))
        aim = goal or TargetState(last.position, _ZERO)
        _step(
            *last, *aim, period, self.max_speed, self.max_acceleration, self.rate, self.braking, self.reach, *new
        )  # fmt: skip
        return new


_ZERO = np.zeros(3)


@compiled
def _step(
    position: Array, velocity: Array, goal: Array, goal_velocity: Array, period: float, max_speed: float,
    max_acceleration: float, rate: float, braking: float, reach: float, new_position: Array, new_velocity: Array,
) -> None:  # fmt: skip
    """Compute `MotionBounds.step` and write the result to `new_position` and `new_velocity`."""
    deceleration = braking * max_acceleration
    for i in range(3):
        new_velocity[i] = goal[i] - position[i]
    left = _length(new_velocity)
    closing = _approach(left, rate, deceleration) / left if left > 0.0 else 0.0
    for i in range(3):
        new_velocity[i] = goal_velocity[i] + closing * new_velocity[i]
    _shorten(new_velocity, max_speed)
    rest = np.empty(3)
    if reach < math.inf:
        # Limit the outward speed so that the setpoint can stop before `reach`. Where the setpoint would come to rest
        # beyond `reach`, turn its velocity inward, so that it moves along the bound.
        _inward(position, new_velocity, reach, rate, deceleration)
        if _rest(position, new_velocity, max_acceleration, rest) > reach:
            _inward(rest, new_velocity, reach, rate, deceleration)
    for i in range(3):
        new_velocity[i] -= velocity[i]
    _shorten(new_velocity, max_acceleration * period)
    for i in range(3):
        new_velocity[i] += velocity[i]
        new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])
    # Brake straight if the setpoint would otherwise come to rest farther beyond `reach` than it is now. A tolerance of
    # 1e-4 of the reach allows a start along the bound from rest.
    if reach < math.inf and _rest(new_position, new_velocity, max_acceleration, rest) > max(
        1.0001 * reach, _rest(position, velocity, max_acceleration, rest)
    ):
        speed = _length(velocity)
        kept = max(0.0, 1.0 - max_acceleration * period / speed) if speed > 0.0 else 0.0
        for i in range(3):
            new_velocity[i] = kept * velocity[i]
            new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])


@compiled
def _inward(here: Array, velocity: Array, reach: float, rate: float, deceleration: float) -> None:
    """Reduce the outward part of a velocity at `here` (3,) to the speed from which it can stop within `reach`."""
    away = _length(here)
    if away == 0.0:
        return
    outward = 0.0
    for i in range(3):
        outward += velocity[i] * here[i] / away
    too_fast = max(0.0, outward - _approach(reach - away, rate, deceleration))
    for i in range(3):
        velocity[i] -= too_fast * here[i] / away


@compiled
def _rest(position: Array, velocity: Array, max_acceleration: float, rest: Array) -> float:
    """Compute where the setpoint comes to rest when it brakes with full acceleration.

    Write the point to `rest` (3,) [m] and return its distance from the origin [m].
    """
    for i in range(3):
        rest[i] = position[i] + 0.5 * _length(velocity) / max_acceleration * velocity[i]
    return _length(rest)


@compiled
def _approach(left: float, rate: float, deceleration: float) -> float:
    """Return the speed [m/s] from which the setpoint can stop within the distance `left` [m].

    For a negative distance the speed is negative: the setpoint moves back.
    """
    near = deceleration / rate**2
    return rate * left if left <= near else math.sqrt(2.0 * deceleration * (left - 0.5 * near))


@compiled
def _shorten(vector: Array, longest: float) -> None:
    length = _length(vector)
    if length > longest:
        for i in range(3):
            vector[i] *= longest / length


@compiled
def _length(vector: Array) -> float:
    return math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
