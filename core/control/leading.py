"""A tip that is led from outside: wishes come when they come, the setpoint goes after the last one in its bounds.

Where the tip should point is gone after by the same law in the plane that touches the sphere of directions where the
wanted one is: the way that is left is the shortest turn to the one that was told, and what moves is an angle.
"""

import math
from typing import NamedTuple

import numpy as np

from core.control.pointing import turn
from core.control.predictor import Place
from core.control.pursuit import Pursuit
from core.control.trajectories import Setpoint, turned
from core.robot.robot import Array

#: How a led tip moves unless whoever leads agrees to something else. A hand's wish does little by itself: it is closed
#: in on fast, and most of the acceleration may go into braking.
BOUNDS = Pursuit(max_speed=0.02, max_acceleration=0.1, rate=20.0, braking=0.8, reach=0.05)


def turns(fastest: float) -> Pursuit:
    """How a wanted direction may turn: at most so fast [rad/s], which it takes 0.2 s to reach, as BOUNDS do."""
    return Pursuit(fastest, 5.0 * fastest, BOUNDS.rate, BOUNDS.braking)


#: And how it turns unless whoever leads agrees to something else.
TURNS = turns(0.2)


class Wish(NamedTuple):
    """What was asked for last."""

    place: Array | None  #: (3,) from the start tip [m]; None: a velocity was asked for
    velocity: Array  #: (3,) asked for, or that of the places [m/s]
    asked: float  #: when it came [s]
    goes_on: float  #: for so long after that it goes on by its velocity [s]
    direction: Array | None = None  #: (3,) in which the tip should point, unit vector; None: none was ever told

    def goal(self, now: float, at: Array) -> Place:
        """Where it wants the setpoint, which is `at` (3,) [m], to be at `now` [s]."""
        since = now - self.asked
        velocity = self.velocity if since < self.goes_on else np.zeros(3)
        if self.place is None:
            return Place(at, velocity)
        return Place(self.place + min(max(since, 0.0), self.goes_on) * self.velocity, velocity)


class LedDirection:
    """The wanted direction of a led tip, from rest where it points at the start."""

    def __init__(self, bounds: Pursuit, start: Array) -> None:
        """`bounds` are of angles: [rad/s] and [rad/s^2] for [m/s] and [m/s^2]; `start` is (3,)."""
        self._bounds = bounds
        self.direction = start  #: (3,) unit vector
        self.turning = np.zeros(3)  #: (3,) its angular velocity [rad/s]

    def advance(self, told: Array | None, period: float) -> None:
        """One `period` [s] on, toward `told` (3,); None: it comes to rest where that is soonest."""
        goal = None if told is None else Place(_shortest(self.direction, told), _STILL)
        way = self._bounds.step(Place(_STILL, self.turning), goal, period)
        self.direction = turned(self.direction, way.position)
        # The plane has turned with the direction: nothing of what is left turns about the direction itself.
        self.turning = way.velocity - float(way.velocity @ self.direction) * self.direction


class LedTip:
    """The setpoint of a led tip, from rest at the start."""

    def __init__(self, bounds: Pursuit, turning: Pursuit = TURNS, pointing: Array | None = None) -> None:
        """`pointing` (3,) is where it points at the start; None: that is not controlled, and no wish turns it."""
        self._bounds = bounds
        self._at = Place(np.zeros(3), np.zeros(3))
        self._pointing = None if pointing is None else LedDirection(turning, pointing)

    @property
    def speed(self) -> float:
        """At which the setpoint moves [m/s]."""
        return float(np.linalg.norm(self._at.velocity))

    @property
    def turning(self) -> float:
        """At which the wanted direction turns [rad/s]."""
        return 0.0 if self._pointing is None else float(np.linalg.norm(self._pointing.turning))

    def advance(self, now: float, wish: Wish | None, period: float) -> Setpoint:
        """The setpoint one `period` [s] on; without a wish it comes to rest where that is soonest."""
        goal = None if wish is None else wish.goal(now, self._at.position)
        self._at = self._bounds.step(self._at, goal, period)
        if self._pointing is None:
            return Setpoint(*self._at)
        self._pointing.advance(None if wish is None else wish.direction, period)
        return Setpoint(*self._at, self._pointing.direction, self._pointing.turning)


def _shortest(here: Array, there: Array) -> Array:
    """The shortest turn (3,) from one direction to the other [rad]; of those to the opposite one, any, but the same."""
    way = turn(here, there)
    if way.any() or float(here @ there) > 0.0:
        return way
    across = np.eye(3)[int(np.argmin(np.abs(here)))]
    across -= float(across @ here) * here
    return across * (math.pi / float(np.linalg.norm(across)))


_STILL = np.zeros(3)
