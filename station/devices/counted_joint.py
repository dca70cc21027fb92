"""Conversion between a joint's position and the counts of its axis, for setups that count from the home position."""

import math
from dataclasses import dataclass, field
from typing import Protocol

from station.config.robots import JointFile


class HomeOptions(Protocol):
    """Options of an axis about its home position."""

    home_at: float | None
    home_speed: float | None
    backwards: bool


def home_of(joint: JointFile, options: HomeOptions) -> tuple[float, float]:
    """Return the joint position at home [rad or m] and the speed of homing [rad/s or m/s], with their defaults."""
    start = joint.upper if options.backwards else joint.lower
    home_at = (0.0 if joint.motion == "rotation" else start) if options.home_at is None else options.home_at
    return home_at, 0.25 * joint.speed if options.home_speed is None else options.home_speed


@dataclass(frozen=True)
class CountedJoint:
    """A joint whose axis counts 0 at its home position; one count is `joint.microstep`."""

    joint: JointFile
    home_at: float  #: joint position at the count 0 [rad or m]
    home_speed: float  #: speed of homing [rad/s or m/s]
    backwards: bool = field(default=False, kw_only=True)  #: whether the count increases when the position decreases

    @property
    def step(self) -> float:
        """Change of the joint's position per count [rad or m]."""
        return -self.joint.microstep if self.backwards else self.joint.microstep

    @property
    def minimum(self) -> int:
        """First whole count inside the joint's travel."""
        return math.ceil(min(self._ends) - 1e-6)

    @property
    def maximum(self) -> int:
        """Last whole count inside the joint's travel."""
        return math.floor(max(self._ends) + 1e-6)

    @property
    def turn(self) -> int:
        """One turn of a rotation [counts]."""
        return round(2.0 * math.pi / self.joint.microstep)

    def position(self, counts: float, /) -> float:
        """Return the joint position at a count of the axis [rad or m]."""
        return self.home_at + self.step * counts

    @property
    def _ends(self) -> tuple[float, float]:
        return (self.joint.lower - self.home_at) / self.step, (self.joint.upper - self.home_at) / self.step
