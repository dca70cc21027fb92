"""Moving by hand: a velocity of the joints or of the tip that lasts only as long as it is asked for anew."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from core.control.trajectories import JointMotion, Setpoint
from core.robot.robot import Array

#: A jog that is not renewed ends after this time [s]: whoever held the button is gone.
ALIVE = 0.3


@dataclass
class Jog:
    """One jog, from the first press until it is let go."""

    space: Literal["joints", "tip"]
    velocity: Array  #: (n,) [rad/s or m/s] of the joints, or (3,) [m/s] of the tip
    heard: float  #: when it was asked for last [s]
    offset: Array  #: (3,) way of the tip's setpoint since it began [m]

    @classmethod
    def begin(cls, space: Literal["joints", "tip"], velocity: Array, now: float) -> "Jog":
        """The first press."""
        return cls(space, velocity, now, np.zeros(3))

    def renew(self, space: Literal["joints", "tip"], velocity: Array, now: float) -> bool:
        """Still pressed; False when it is another kind of jog, which has to begin anew."""
        if space != self.space:
            return False
        self.velocity, self.heard = velocity, now
        return True

    def order(self, now: float, period: float) -> JointMotion | Setpoint | None:
        """What this tick has to do; None once it was let go."""
        if now - self.heard > ALIVE:
            return None
        if self.space == "joints":
            return JointMotion(self.velocity)
        self.offset = self.offset + period * self.velocity
        return Setpoint(self.offset, self.velocity)
