"""A setpoint that goes after a moving goal with bounded speed and acceleration, and comes to rest without one.

On the goal it has the goal's velocity and no lag. Away from it it closes in as fast as it can stop: at a rate while
near, by half of the acceleration from further off; the other half is for what the goal does meanwhile.
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
    rate: float = 5.0  #: at which what is left of the way shrinks [1/s]

    def __post_init__(self) -> None:
        for name, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s^2"), ("rate", "1/s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"pursuit: {name} {value:g} {unit} must be finite and greater than 0")

    def step(self, last: Place, goal: Place | None, period: float) -> Place:
        """Where the setpoint is `period` [s] after `last`, when `goal` is where it should be; None: it should rest."""
        new = Place(np.empty(3), np.empty(3))
        known = goal or last
        _step(*last, *known, goal is not None, period, self.max_speed, self.max_acceleration, self.rate, *new)
        return new


@compiled
def _step(
    position: Array, velocity: Array, goal: Array, goal_velocity: Array, wanted: bool, period: float,
    max_speed: float, max_acceleration: float, rate: float, new_position: Array, new_velocity: Array,
) -> None:  # fmt: skip
    """`Pursuit.step`, into the last two."""
    gap = 0.0
    for i in range(3):
        gap += (goal[i] - position[i]) ** 2
    gap = math.sqrt(gap)
    braking = 0.5 * max_acceleration
    near = braking / rate**2
    closing = rate * gap if gap <= near else math.sqrt(2.0 * braking * (gap - 0.5 * near))
    speed, change = 0.0, 0.0
    for i in range(3):
        new_velocity[i] = 0.0
        if wanted:
            new_velocity[i] = goal_velocity[i] + (closing * (goal[i] - position[i]) / gap if gap > 0.0 else 0.0)
        speed += new_velocity[i] ** 2
    slower = min(1.0, max_speed / math.sqrt(speed)) if speed > 0.0 else 1.0
    for i in range(3):
        new_velocity[i] *= slower
        change += (new_velocity[i] - velocity[i]) ** 2
    part = min(1.0, max_acceleration * period / math.sqrt(change)) if change > 0.0 else 1.0
    for i in range(3):
        new_velocity[i] = velocity[i] + part * (new_velocity[i] - velocity[i])
        new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])
