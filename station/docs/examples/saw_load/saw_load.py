"""A sawtooth load: the force grows linearly along a direction, drops to zero, and grows again."""

import math
from dataclasses import dataclass

import numpy as np

from core.robot.robot import Array
from station.config.plugins import Setup


@dataclass(frozen=True)
class SawLoad:
    """Sawtooth force at the tip."""

    peak: float  #: largest force [N]
    period: float  #: time from one drop to the next [s]
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)  #: world frame; +x is down

    def __post_init__(self) -> None:
        if not (0.0 <= self.peak <= 20.0 and self.period >= 0.1 and math.hypot(*self.direction) > 0.0):
            raise ValueError(f"{self}: expected a peak of 0 ... 20 N, a period of 0.1 s or more, and a direction")

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start."""
        unit = np.array(self.direction) / math.hypot(*self.direction)
        return self.peak * (time / self.period % 1.0) * unit


def make(setup: Setup) -> SawLoad:
    """Return the load with the keys of the file."""
    return SawLoad(**setup.options)
