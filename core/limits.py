"""What the joints may do: speed, travel and the distance it takes to stop."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, PoseError
from core.robot import Array


@dataclass(frozen=True)
class JointLimit:
    """Limits of one joint, in its own unit (rad or m)."""

    name: str
    unit: str
    lower: float
    upper: float
    speed: float  #: per second
    acceleration: float  #: per second squared

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise DescriptionError(f"{self.name}: travel {self.lower:g} ... {self.upper:g} {self.unit} is empty")
        for what, value, per in (("speed", self.speed, "s"), ("acceleration", self.acceleration, "s^2")):
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"{self.name}: {what} limit {value:g} {self.unit}/{per} must be greater than 0")


@dataclass(frozen=True)
class Limits:
    """Limits of all joints in the robot's order."""

    joints: tuple[JointLimit, ...]
    reaction: float = 0.075  #: time from a command to its effect, counted as travel still to come [s]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.reaction) and self.reaction >= 0.0):
            raise DescriptionError(f"reaction {self.reaction:g} s must be finite and at least 0")

    @cached_property
    def _arrays(self) -> tuple[Array, Array, Array, Array]:
        rows = [(j.lower, j.upper, j.speed, j.acceleration) for j in self.joints]
        lower, upper, speed, acceleration = np.array(rows).T.copy()
        return lower, upper, speed, acceleration

    @property
    def speed(self) -> Array:
        """(n,) [rad/s or m/s]."""
        return self._arrays[2]

    def check(self, joints: Array) -> None:
        """Raise PoseError when a position (n,) is not finite or outside its travel."""
        for limit, value in zip(self.joints, joints, strict=True):
            if not limit.lower <= value <= limit.upper:
                raise PoseError(
                    f"{limit.name} {value:.4g} {limit.unit} is outside"
                    f" {limit.lower:.4g} ... {limit.upper:.4g} {limit.unit} (its travel)"
                )

    def velocity_bounds(self, joints: Array) -> tuple[Array, Array]:
        """Lowest and highest velocity (n,) from which each joint can still stop inside its travel."""
        return _velocity_bounds(joints, *self._arrays, self.reaction)


@compiled
def _velocity_bounds(
    joints: Array, lower: Array, upper: Array, speed: Array, acceleration: Array, reaction: float
) -> tuple[Array, Array]:
    lowest, highest = np.empty_like(joints), np.empty_like(joints)
    for i in range(joints.shape[0]):
        lag = acceleration[i] * reaction
        lowest[i] = -min(speed[i], _braking(joints[i] - lower[i], acceleration[i], lag))
        highest[i] = min(speed[i], _braking(upper[i] - joints[i], acceleration[i], lag))
    return lowest, highest


@compiled
def _braking(room: float, acceleration: float, lag: float) -> float:
    """Largest v with v * reaction + v^2 / (2 a) <= room; `lag` is a * reaction."""
    if not room > 0.0:  # NaN included: min and max would let it pass as full speed
        return 0.0
    return np.sqrt(lag * lag + 2.0 * acceleration * room) - lag
