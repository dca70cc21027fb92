"""Moving by hand: a velocity of the joints or of the tip that lasts only as long as it is asked for anew."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from core.control.trajectories import JointMotion, Setpoint, turned
from core.robot.robot import Array

#: A jog that is not renewed ends after this time [s]: whoever held the button is gone.
ALIVE = 0.3
#: What is moved by hand: joints; the tip's place; where the tip points, its place kept.
Space = Literal["joints", "tip", "direction"]


@dataclass
class Jog:
    """One jog, from the first press until it is let go."""

    space: Space
    velocity: Array  #: (n,) [rad/s or m/s] of the joints, (3,) [m/s] of the tip, or (3,) [rad/s] of its direction
    heard: float  #: when it was asked for last [s]
    offset: Array  #: (3,) way of the tip's setpoint since it began [m]
    direction: Array | None  #: (3,) where the tip should point; None keeps that of the beginning

    @classmethod
    def begin(cls, space: Space, velocity: Array, now: float, pointing: Array | None = None) -> "Jog":
        """The first press; `pointing` (3,) is where the tip points, for a jog in direction."""
        return cls(space, velocity, now, np.zeros(3), pointing if space == "direction" else None)

    def renew(self, space: Space, velocity: Array, now: float) -> bool:
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
        if self.direction is not None:
            self.direction = turned(self.direction, period * self.velocity)
            return Setpoint(self.offset, np.zeros(3), self.direction, self.velocity)
        self.offset = self.offset + period * self.velocity
        return Setpoint(self.offset, self.velocity)
