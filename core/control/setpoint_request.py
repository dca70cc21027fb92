"""Setpoint of the tip from a streaming client: the setpoint follows the client's latest request within motion bounds.

Requests may arrive at any time. The tip's direction follows the requested direction by the same law, in the tangent
plane of the sphere of directions. The remaining distance is then the angle of the shortest rotation to the requested
direction.
"""

import math
from typing import NamedTuple

import numpy as np

from core.control.motion_bounds import MotionBounds
from core.control.predictor import TargetState
from core.control.tip_direction import shortest_rotation
from core.control.trajectories import Setpoint, rotated
from core.robot.robot import Array

#: Default bounds on the motion of a streamed setpoint. An operator's hand moves smoothly, so the approach may be fast,
#: and most of the acceleration may be planned for braking.
DEFAULT_MOTION_BOUNDS = MotionBounds(max_speed=0.02, max_acceleration=0.1, rate=20.0, braking=0.8, reach=0.05)


def turn_bounds(fastest: float) -> MotionBounds:
    """Return motion bounds for a tip direction: angular speed at most `fastest` [rad/s], reached in 0.2 s."""
    return MotionBounds(fastest, 5.0 * fastest, DEFAULT_MOTION_BOUNDS.rate, DEFAULT_MOTION_BOUNDS.braking)


#: Default bounds on the rotation of a streamed tip direction: 0.2 rad/s.
DEFAULT_TURN_BOUNDS = turn_bounds(0.2)


class SetpointRequest(NamedTuple):
    """Latest setpoint received from the streaming client."""

    position: Array | None  #: (3,) requested position from the start tip [m]; None: the request is a velocity
    velocity: Array  #: (3,) requested velocity; with a position: velocity of the requested position [m/s]
    time: float  #: time at which the request was received [s]
    extrapolation: float  #: time for which `velocity` moves the goal [s]; afterwards the goal is `position`, at rest
    direction: Array | None = None  #: (3,) requested direction of the tip, unit vector; None: never requested

    def goal(self, now: float, at: Array) -> TargetState:
        """Return the requested goal at time `now` [s] for a setpoint that is at `at` (3,) [m]."""
        since = max(now - self.time, 0.0)
        velocity = self.velocity if since < self.extrapolation else _ZERO
        if self.position is None:
            return TargetState(at, velocity)
        return TargetState(self.position + since * velocity, velocity)


class StreamedDirection:
    """Streamed direction of the tip; it starts at rest at the tip's start direction."""

    def __init__(self, bounds: MotionBounds, start: Array) -> None:
        """Start at direction `start` (3,); `bounds` apply to angles, in rad/s and rad/s^2 instead of m/s and m/s^2."""
        self._bounds = bounds
        self.direction = start  #: (3,) present direction, unit vector
        self.turning = np.zeros(3)  #: (3,) angular velocity of the direction [rad/s]

    def advance(self, requested: Array | None, period: float) -> None:
        """Rotate for one `period` [s] toward the direction `requested` (3,); None: stop as soon as possible."""
        goal = None if requested is None else TargetState(_rotation_toward(self.direction, requested), _ZERO)
        rotation = self._bounds.step(TargetState(_ZERO, self.turning), goal, period)
        self.direction = rotated(self.direction, rotation.position)
        # The tangent plane has rotated: remove the component about the direction itself.
        self.turning = rotation.velocity - float(rotation.velocity @ self.direction) * self.direction


class StreamedTip:
    """Streamed setpoint of the tip; it starts at rest at the start tip."""

    def __init__(
        self, bounds: MotionBounds, turning: MotionBounds = DEFAULT_TURN_BOUNDS, pointing: Array | None = None
    ) -> None:
        """Start with direction `pointing` (3,); None: the direction is not controlled."""
        self._bounds = bounds
        self._at = TargetState(np.zeros(3), np.zeros(3))
        self._pointing = None if pointing is None else StreamedDirection(turning, pointing)

    @property
    def speed(self) -> float:
        """Speed of the setpoint [m/s]."""
        return float(np.linalg.norm(self._at.velocity))

    @property
    def turning(self) -> float:
        """Angular speed of the streamed direction [rad/s]."""
        return 0.0 if self._pointing is None else float(np.linalg.norm(self._pointing.turning))

    def advance(self, now: float, request: SetpointRequest | None, period: float) -> Setpoint:
        """Return the setpoint one `period` [s] later, at `now` [s]; without a request it comes to rest."""
        goal = None if request is None else request.goal(now, self._at.position)
        self._at = self._bounds.step(self._at, goal, period)
        if self._pointing is None:
            return Setpoint(*self._at)
        self._pointing.advance(None if request is None else request.direction, period)
        return Setpoint(*self._at, self._pointing.direction, self._pointing.turning)


def _rotation_toward(here: Array, there: Array) -> Array:
    """Return the shortest rotation (3,) between two directions [rad]; between opposite ones its axis is arbitrary."""
    rotation = shortest_rotation(here, there)
    if rotation.any() or float(here @ there) > 0.0:
        return rotation
    across = np.eye(3)[int(np.argmin(np.abs(here)))]
    across -= float(across @ here) * here
    return across * (math.pi / float(np.linalg.norm(across)))


_ZERO = np.zeros(3)
