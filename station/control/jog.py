"""Jogging: a velocity of the joints or of the tip that is applied only while the client renews it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from core.control.trajectories import JointMotion, Setpoint, rotated
from core.robot.robot import Array

#: Time after which a jog that is not renewed ends [s]: its button was released or its client is gone.
JOG_TIMEOUT_S = 0.3
#: What a jog moves: the joints, the tip's position, or the tip's direction at constant position.
Space = Literal["joints", "tip", "direction"]


@dataclass
class Jog:
    """One jog, from the first press of the operator's button until its release."""

    space: Space
    velocity: (
        Array  #: velocity of the joints (n,) [rad/s or m/s], of the tip (3,) [m/s] or of its direction (3,) [rad/s]
    )
    renewed: float  #: time of the last renewal [s]
    offset: Array  #: (3,) displacement of the tip's setpoint since the start [m]
    direction: Array | None  #: (3,) desired direction of the tip; None: keep the direction of the start

    @classmethod
    def start(cls, space: Space, velocity: Array, now: float, pointing: Array | None = None) -> "Jog":
        """Return a new jog; `pointing` (3,) is the present direction of the tip, needed for a jog of the direction."""
        return cls(space, velocity, now, np.zeros(3), pointing if space == "direction" else None)

    def renew(self, space: Space, velocity: Array, now: float) -> bool:
        """Renew the jog with a velocity; return False if `space` differs, because another space needs a new jog."""
        if space != self.space:
            return False
        self.velocity, self.renewed = velocity, now
        return True

    def order(self, now: float, period: float) -> JointMotion | Setpoint | None:
        """Return this tick's joint velocities or setpoint; None after the client has stopped renewing the jog."""
        if now - self.renewed > JOG_TIMEOUT_S:
            return None
        if self.space == "joints":
            return JointMotion(self.velocity)
        if self.direction is not None:
            self.direction = rotated(self.direction, period * self.velocity)
            return Setpoint(self.offset, np.zeros(3), self.direction, self.velocity)
        self.offset = self.offset + period * self.velocity
        return Setpoint(self.offset, self.velocity)
