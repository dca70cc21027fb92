"""Setpoint of the tip that follows a goal within motion bounds, for example the latest request of a streaming client.

**Motion bounds.** At the goal, the setpoint has the goal's velocity and no lag. Elsewhere the setpoint approaches the
goal at the speed from which it can still stop at the goal. The setpoint's velocity is

    v = v_goal + e / |e| c(|e|),    c(s) = K s  up to s = b a / K^2,  sqrt(2 b a (s - b a / (2 K^2)))  beyond,

with the remaining displacement e, the approach rate K, the largest acceleration a, and its fraction b for braking. Near
the goal the distance decays exponentially; from farther away the setpoint brakes with constant deceleration. The
slope of the speed c(s) is continuous where the two formulas meet. The rest of the acceleration is reserved for the
motion of the goal.

**Requests** may arrive at any time. The tip's direction follows the requested direction by the same law, in the tangent
plane of the sphere of directions. The remaining distance is then the angle of the shortest rotation to the requested
direction.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.predictor import TargetState
from core.control.tip_direction import shortest_rotation
from core.control.trajectories import Setpoint, rotated
from core.errors import DescriptionError
from core.robot.robot import Array, positive


@dataclass(frozen=True)
class MotionBounds:
    """Bounds on speed, acceleration and position of a setpoint."""

    max_speed: float  #: largest speed of the setpoint [m/s]
    max_acceleration: float  #: largest acceleration of the setpoint [m/s^2]
    rate: float = 5.0  #: rate K at which the remaining distance decays near the goal [1/s]
    braking: float = 0.5  #: fraction b of the acceleration that is planned for braking
    reach: float = math.inf  #: largest distance of the setpoint from the origin [m]

    def __post_init__(self) -> None:
        for name, unit in (("max_speed", "m/s"), ("max_acceleration", "m/s^2"), ("rate", "1/s")):
            positive(f"motion bounds: {name}", getattr(self, name), unit)
        if not 0.0 < self.braking <= 1.0:
            raise DescriptionError(f"motion bounds: braking {self.braking:g} must be greater than 0 and at most 1")
        if not self.reach > 0.0:
            raise DescriptionError(f"motion bounds: reach {self.reach:g} m must be greater than 0")

    def step(self, last: TargetState, goal: TargetState | None, period: float) -> TargetState:
        """Return the setpoint one `period` [s] after `last` on its path to `goal`; without a goal it stops."""
        new = TargetState(np.empty(3), np.empty(3))
        aim = goal or TargetState(last.position, _ZERO)
        _step(
            *last, *aim, period, self.max_speed, self.max_acceleration, self.rate, self.braking, self.reach, *new
        )  # fmt: skip
        return new


_ZERO = np.zeros(3)


@compiled
def _step(
    position: Array, velocity: Array, goal: Array, goal_velocity: Array, period: float, max_speed: float,
    max_acceleration: float, rate: float, braking: float, reach: float, new_position: Array, new_velocity: Array,
) -> None:  # fmt: skip
    """Compute `MotionBounds.step` and write the result to `new_position` and `new_velocity`."""
    deceleration = braking * max_acceleration
    for i in range(3):
        new_velocity[i] = goal[i] - position[i]
    left = _length(new_velocity)
    closing = _approach(left, rate, deceleration) / left if left > 0.0 else 0.0
    for i in range(3):
        new_velocity[i] = goal_velocity[i] + closing * new_velocity[i]
    _shorten(new_velocity, max_speed)
    rest = np.empty(3)
    if reach < math.inf:
        # Limit the outward speed so that the setpoint can stop before `reach`. Where the setpoint would come to rest
        # beyond `reach`, turn its velocity inward, so that it moves along the bound.
        _inward(position, new_velocity, reach, rate, deceleration)
        if _rest(position, new_velocity, max_acceleration, rest) > reach:
            _inward(rest, new_velocity, reach, rate, deceleration)
    for i in range(3):
        new_velocity[i] -= velocity[i]
    _shorten(new_velocity, max_acceleration * period)
    for i in range(3):
        new_velocity[i] += velocity[i]
        new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])
    # Brake straight if the setpoint would otherwise come to rest farther beyond `reach` than it is now. A tolerance of
    # 1e-4 of the reach allows a start along the bound from rest.
    if reach < math.inf and _rest(new_position, new_velocity, max_acceleration, rest) > max(
        1.0001 * reach, _rest(position, velocity, max_acceleration, rest)
    ):
        speed = _length(velocity)
        kept = max(0.0, 1.0 - max_acceleration * period / speed) if speed > 0.0 else 0.0
        for i in range(3):
            new_velocity[i] = kept * velocity[i]
            new_position[i] = position[i] + 0.5 * period * (velocity[i] + new_velocity[i])


@compiled
def _inward(here: Array, velocity: Array, reach: float, rate: float, deceleration: float) -> None:
    """Reduce the outward part of a velocity at `here` (3,) to the speed from which it can stop within `reach`."""
    away = _length(here)
    if away == 0.0:
        return
    outward = 0.0
    for i in range(3):
        outward += velocity[i] * here[i] / away
    too_fast = max(0.0, outward - _approach(reach - away, rate, deceleration))
    for i in range(3):
        velocity[i] -= too_fast * here[i] / away


@compiled
def _rest(position: Array, velocity: Array, max_acceleration: float, rest: Array) -> float:
    """Compute where the setpoint comes to rest when it brakes with full acceleration.

    Write the point to `rest` (3,) [m] and return its distance from the origin [m].
    """
    for i in range(3):
        rest[i] = position[i] + 0.5 * _length(velocity) / max_acceleration * velocity[i]
    return _length(rest)


@compiled
def _approach(left: float, rate: float, deceleration: float) -> float:
    """Return the speed [m/s] from which the setpoint can stop within the distance `left` [m].

    For a negative distance the speed is negative: the setpoint moves back.
    """
    near = deceleration / rate**2
    return rate * left if left <= near else math.sqrt(2.0 * deceleration * (left - 0.5 * near))


@compiled
def _shorten(vector: Array, longest: float) -> None:
    length = _length(vector)
    if length > longest:
        for i in range(3):
            vector[i] *= longest / length


@compiled
def _length(vector: Array) -> float:
    return math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)


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
    time: float  #: time at which the request was received, without the network's jitter if its sender gave times [s]
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
