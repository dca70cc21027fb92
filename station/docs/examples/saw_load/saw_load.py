"""A sawtooth load for cases that a script runs in virtual time.

The force grows linearly along a direction, drops to zero, and grows again.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from core.robot.robot import Array


@dataclass(frozen=True)
class SawLoad:
    """Sawtooth force at the tip."""

    peak: float  #: largest force [N]
    period: float  #: time from one drop to the next [s]
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)  #: world frame; +x is down
    kind: Literal["saw"] = "saw"
    contact: float = math.inf  #: arc length of the point of application [m]; inf: the tip
    onset: float = 0.0  #: time at which the load starts [s]
    changes: tuple[float, ...] = (0.0,)  #: times at which a constant load starts to change [s]

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        unit = np.array(self.direction) / math.hypot(*self.direction)
        return self.peak * (max(time, 0.0) / self.period % 1.0) * unit
