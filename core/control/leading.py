"""A tip that is led from outside: wishes come when they come, the setpoint goes after the last one in its bounds."""

from typing import NamedTuple

import numpy as np

from core.control.predictor import Place
from core.control.pursuit import Pursuit
from core.control.trajectories import Setpoint
from core.robot.robot import Array

#: How a led tip moves unless whoever leads agrees to something else. A hand's wish does little by itself: it is closed
#: in on fast, and most of the acceleration may go into braking.
BOUNDS = Pursuit(max_speed=0.02, max_acceleration=0.1, rate=20.0, braking=0.8, reach=0.05)


class Wish(NamedTuple):
    """What was asked for last."""

    place: Array | None  #: (3,) from the start tip [m]; None: a velocity was asked for
    velocity: Array  #: (3,) asked for, or that of the places [m/s]
    asked: float  #: when it came [s]
    goes_on: float  #: for so long after that it goes on by its velocity [s]

    def goal(self, now: float, at: Array) -> Place:
        """Where it wants the setpoint, which is `at` (3,) [m], to be at `now` [s]."""
        since = now - self.asked
        velocity = self.velocity if since < self.goes_on else np.zeros(3)
        if self.place is None:
            return Place(at, velocity)
        return Place(self.place + min(max(since, 0.0), self.goes_on) * self.velocity, velocity)


class LedTip:
    """The setpoint of a led tip, from rest at the start."""

    def __init__(self, bounds: Pursuit) -> None:
        self._bounds = bounds
        self._at = Place(np.zeros(3), np.zeros(3))

    @property
    def speed(self) -> float:
        """At which the setpoint moves [m/s]."""
        return float(np.linalg.norm(self._at.velocity))

    def advance(self, now: float, wish: Wish | None, period: float) -> Setpoint:
        """The setpoint one `period` [s] on; without a wish it comes to rest where that is soonest."""
        goal = None if wish is None else wish.goal(now, self._at.position)
        self._at = self._bounds.step(self._at, goal, period)
        return Setpoint(*self._at)
