"""Trajectories of the tip: desired offset from the tip at the start of the motion, and its velocity.

Every motion starts at offset zero, at the present tip. A motion with a `period` repeats itself, so checking one period
of it is enough.
"""

import bisect
import itertools
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Protocol, cast

import numpy as np
from pydantic import Field, field_validator

from core.control.force_control import Press
from core.control.stiffness import TipStiffness
from core.errors import DescriptionError
from core.robot.robot import Array
from core.strict import Direction, Position, Row, Strict

#: Largest number of waypoints, or of directions, of a motion; its check on the model takes seconds.
MAX_WAYPOINTS = 10_000
#: Rows of a time [s] and a vector. Without `fail_fast` a long list with an invalid row would be validated to its end.
TimedVectors = Annotated[
    tuple[Annotated[tuple[float, float, float, float], Row], ...],
    Field(max_length=MAX_WAYPOINTS, strict=False, fail_fast=True),
]

ZERO_VELOCITY = np.zeros(3)
#: Smallest and largest length of a direction vector. The length has no meaning, but its square must be finite.
MIN_DIRECTION, MAX_DIRECTION = 1e-9, 1e9


class Setpoint(NamedTuple):
    """Desired position, velocity and direction of the tip, world frame; the position is relative to the start tip."""

    position: Array  #: (3,) desired offset from the start tip [m]
    velocity: Array  #: (3,) desired velocity of the tip [m/s]
    direction: Array | None = None  #: (3,) desired direction of the tip, unit vector; None keeps the start direction
    turning: Array = ZERO_VELOCITY  #: (3,) angular velocity of the desired direction [rad/s]
    press: Press | None = None  #: force that the tip shall exert; along its direction the position is not controlled
    stiffness: TipStiffness | None = None  #: present stiffness of the tip; None: that of the controller, if it has one


class JointMotion(NamedTuple):
    """Directly commanded joint velocities, for example for an approach, a jog, or a sweep of one joint."""

    velocity: Array  #: (n,) commanded joint velocities [rad/s or m/s]


class Trajectory(Protocol):
    """A motion of the tip over time."""

    @property
    def period(self) -> float:
        """Time after which the motion repeats itself or stays at rest [s]."""
        ...

    def setpoint(self, time: float) -> Setpoint:
        """Return the desired offset and velocity at `time` [s] from the start."""
        ...


#: Shortest time between two waypoints [s].
MIN_WAYPOINT_INTERVAL_S = 1e-3
#: Latest time [s] and largest offset per axis [m] of a waypoint: one day and 10 m, more than a motion needs. Much
#: larger numbers would overflow the spline's coefficients.
MAX_TIME_S, MAX_OFFSET_M = 86_400.0, 10.0


@dataclass(frozen=True)
class Directions:
    """Direction of the tip over time: it rotates from each direction to the next about a fixed axis and stops there."""

    rows: TimedVectors  #: increasing times [s], each with a vector of any nonzero length; none is opposite to the next

    def __post_init__(self) -> None:
        for time in self.times:
            if not abs(time) <= MAX_TIME_S:
                raise DescriptionError(f"directions: time {time:g} s is outside +-{MAX_TIME_S:g} s")
        for before, after in zip(self.times, self.times[1:], strict=False):
            if not after - before >= MIN_WAYPOINT_INTERVAL_S:
                raise DescriptionError(
                    f"directions: the time {after:g} s must be {1e3 * MIN_WAYPOINT_INTERVAL_S:g} ms or more after"
                    f" the time before it, {before:g} s"
                )
        for first, second in itertools.pairwise(self._units):
            if float(first @ second) < -0.999:
                raise DescriptionError("directions: two consecutive directions are opposite; add one between them")

    @cached_property
    def times(self) -> tuple[float, ...]:
        """Times at which the tip has each direction [s]."""
        return tuple(row[0] for row in self.rows)

    @cached_property
    def _units(self) -> list[Array]:
        return [_unit("directions", row[1:]) for row in self.rows]

    def at(self, time: float) -> tuple[Array, Array]:
        """Return the direction (3,) and its angular velocity (3,) [rad/s] at `time` [s]."""
        after = bisect.bisect_right(self.times, time)
        if after == 0 or after == len(self.times):
            return self._units[max(0, after - 1)], ZERO_VELOCITY
        first, second = self._units[after - 1 : after + 1]
        length = self.times[after] - self.times[after - 1]
        axis, part = _cross(first, second), math.pi * (time - self.times[after - 1]) / length
        sin = float(np.linalg.norm(axis))
        whole = math.atan2(sin, float(first @ second))
        if whole < 1e-9:
            return first, ZERO_VELOCITY
        axis /= sin
        angle, rate = whole * 0.5 * (1.0 - math.cos(part)), whole * 0.5 * math.pi / length * math.sin(part)
        return first * math.cos(angle) + _cross(axis, first) * math.sin(angle), axis * rate


def _setpoint(x: float, y: float, z: float, vx: float, vy: float, vz: float) -> Setpoint:
    """Return a setpoint from numbers, which avoids operations on small arrays: each takes a microsecond."""
    both = np.array((x, y, z, vx, vy, vz))
    return Setpoint(both[:3], both[3:])


@dataclass(frozen=True)
class Pressed:
    """A trajectory with a force along a direction."""

    path: Trajectory  #: trajectory of the tip; only its component across the direction is followed
    press: Press

    @property
    def period(self) -> float:
        """Time after which the path repeats itself or stays at rest [s]."""
        return self.path.period

    def setpoint(self, time: float) -> Setpoint:
        """Return the desired offset, velocity and force at `time` [s] from the start."""
        return self.path.setpoint(time)._replace(press=self.press)


class PointedMotion(Strict):
    """A motion with a desired direction of the tip, for controllers whose task includes the direction."""

    directions: TimedVectors = ()
    """time [s] and the desired direction x, y, z of the tip; empty keeps the direction at the start"""

    @field_validator("directions")
    @classmethod
    def _can_be(cls, rows: TimedVectors) -> TimedVectors:
        try:
            directions_of(rows)
        except DescriptionError as error:
            raise ValueError(str(error)) from None
        return rows


def directions_of(rows: TimedVectors) -> Directions | None:
    """Return the direction of the tip over time; None keeps the direction at the start."""
    return Directions(rows) if rows else None


class HoldMotion(PointedMotion):
    """Keep the tip where it is."""

    kind: Literal["hold"] = "hold"

    @property
    def period(self) -> float:
        """Time until the motion is at rest [s]."""
        return 0.0

    def setpoint(self, time: float) -> Setpoint:  # noqa: ARG002 - the same at any time
        """Return offset zero at any time."""
        return Setpoint(np.zeros(3), np.zeros(3))


class StepMotion(PointedMotion):
    """Step the desired position of the tip, to measure the step response."""

    kind: Literal["step"] = "step"
    offset: Position
    """offset of the second position from the tip at the start [m]"""
    stay: Annotated[float, Field(gt=0.0, le=3600.0)] | None = None
    """time at each of the two positions before the next step [s]; if not set, there is only one step"""

    @property
    def period(self) -> float:
        """Time until the motion is at rest [s], except for single steps."""
        return 0.0

    def setpoint(self, time: float) -> Setpoint:
        """Return the start tip or the other position, depending on `time` [s]; the velocity is zero."""
        there = self.stay is None or int(time / self.stay) % 2 == 0
        return Setpoint(np.array(self.offset) if there else np.zeros(3), np.zeros(3))


class SinusoidMotion(PointedMotion):
    """Move the tip back and forth along a line."""

    kind: Literal["sinusoid"] = "sinusoid"
    direction: Direction = (0.0, 0.0, 1.0)
    """direction of the line, world frame; its length does not matter"""
    amplitude: Annotated[float, Field(gt=0.0, le=0.1)]
    """largest displacement to either side [m]"""
    frequency: Annotated[float, Field(gt=0.0, le=5.0)]
    """frequency of the oscillation [Hz]"""

    @property
    def period(self) -> float:
        """Duration of one oscillation [s]."""
        return 1.0 / self.frequency

    def setpoint(self, time: float) -> Setpoint:
        """Return amplitude * sin(2 pi f t) along the direction."""
        (x, y, z), rate = _axis(self.direction), 2.0 * math.pi * self.frequency
        offset, speed = self.amplitude * math.sin(rate * time), self.amplitude * rate * math.cos(rate * time)
        return _setpoint(x * offset, y * offset, z * offset, x * speed, y * speed, z * speed)


class CircleMotion(PointedMotion):
    """Move the tip along a circle through its start."""

    kind: Literal["circle"] = "circle"
    radius: Annotated[float, Field(gt=0.0, le=0.1)]
    """radius of the circle [m]"""
    period: Annotated[float, Field(ge=0.2, le=3600.0)]
    """time for one turn [s]"""
    normal: Direction = (0.0, 0.0, 1.0)
    """axis of the circle, world frame; its length does not matter"""

    def setpoint(self, time: float) -> Setpoint:
        """Return a point of the circle; the circle starts at offset zero, and its centre is one `radius` away."""
        return _on_circle(self.radius, self.period, self.normal, time)


class HelixMotion(PointedMotion):
    """Move the tip along a helix: turn about an axis while advancing along this axis."""

    kind: Literal["helix"] = "helix"
    radius: Annotated[float, Field(gt=0.0, le=0.1)]
    """radius of the turns [m]"""
    pitch: Annotated[float, Field(ge=-0.1, le=0.1)]
    """advance per turn along `axis`; a negative pitch moves against it [m]"""
    turn: Annotated[float, Field(ge=0.2, le=3600.0)]
    """time for one turn [s]"""
    turns: Annotated[float, Field(gt=0.0, le=1000.0)]
    """number of turns; after them the tip stays at the end of the helix"""
    axis: Direction = (0.0, 0.0, 1.0)
    """axis of the helix, world frame; its length does not matter"""

    @property
    def period(self) -> float:
        """Time until the motion is at rest [s]."""
        return self.turns * self.turn

    def setpoint(self, time: float) -> Setpoint:
        """Return a point of the helix; the helix starts at offset zero, like the circle."""
        if time >= self.period:
            return Setpoint(self._at(self.period).position, np.zeros(3))
        return self._at(time)

    def _at(self, time: float) -> Setpoint:
        round_ = _on_circle(self.radius, self.turn, self.axis, time)
        speed = np.array(_axis(self.axis)) * (self.pitch / self.turn)
        return Setpoint(round_.position + speed * time, round_.velocity + speed)


def _on_circle(radius: float, period: float, normal: tuple[float, float, float], time: float) -> Setpoint:
    plane, rate = _plane(normal), 2.0 * math.pi / period
    cos, sin = math.cos(rate * time), math.sin(rate * time)
    a, b = radius * (cos - 1.0), radius * sin
    c, d = radius * rate * cos, radius * rate * sin
    return _setpoint(
        *[first * a + second * b for first, second in plane],
        *[second * c - first * d for first, second in plane],
    )


# The results of both functions are cached, because each tick of a motion calls them with the same direction.
@lru_cache(maxsize=64)
def _axis(direction: tuple[float, float, float]) -> list[float]:
    """Return the unit vector of a direction."""
    return _unit("motion", direction).tolist()


@lru_cache(maxsize=64)
def _plane(normal: tuple[float, float, float]) -> list[list[float]]:
    """Return pairs of coordinates of two unit vectors that are perpendicular to `normal` and to each other.

    The first vector is computed from the coordinate axis that is most nearly perpendicular to `normal`.
    """
    axis = _unit("motion", normal)
    first = _cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis)
    first /= np.linalg.norm(first)
    return np.transpose((first, _cross(axis, first))).tolist()


@dataclass(frozen=True)
class Waypoints:
    """Trajectory along a cubic spline through waypoints, from rest at the start tip to rest at the last waypoint.

    The path from the start tip to the first waypoint is the approach; the first time is its duration.
    """

    times: tuple[float, ...]  #: increasing times of the waypoints; the first is above 0 unless it is the start tip [s]
    places: tuple[tuple[float, float, float], ...]  #: offsets of the waypoints from the start tip [m]
    max_speed: float = 0.02  #: largest accepted speed of the tip [m/s]
    max_acceleration: float = 0.1  #: largest accepted acceleration of the tip [m/s^2]

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.places):
            raise DescriptionError(f"waypoints: {len(self.times)} times and {len(self.places)} places; give one each")
        for number, (time, point) in enumerate(zip(self.times, self.places, strict=True), 1):
            if not (time <= MAX_TIME_S and all(abs(part) <= MAX_OFFSET_M for part in point)):
                raise DescriptionError(
                    f"waypoints: number {number} at {time:g} s, {point} m, is outside 0 ... {MAX_TIME_S:g} s or"
                    f" +-{MAX_OFFSET_M:g} m"
                ).at(time)
        if self.times[0] < 0.0 or (self.times[0] == 0.0 and any(self.places[0])):
            raise DescriptionError(
                f"waypoints: the first, {self.places[0]} m from the start tip, has the time {self.times[0]:g} s;"
                " give it a time above 0 s, so that the tip can get there"
            ).at(self.times[0])
        for before, after in zip(self.times, self.times[1:], strict=False):
            if not after > before:
                raise DescriptionError(f"waypoints: time {after:g} s must be after the time {before:g} s").at(after)
        for before, after in zip((0.0, *self.times), self.times, strict=False):
            # Shorter intervals overflow the spline's coefficients; comparisons with the resulting NaN are always false.
            if 0.0 < after - before < MIN_WAYPOINT_INTERVAL_S:
                raise DescriptionError(
                    f"waypoints: {after:g} s is less than {1e3 * MIN_WAYPOINT_INTERVAL_S:g} ms after {before:g} s;"
                    f" give this waypoint a later time"
                ).at(after)
        self._check_limits()

    @property
    def period(self) -> float:
        """Time until the motion is at rest [s]."""
        return self.times[-1]

    @cached_property
    def _spline(self) -> tuple[list[float], Array]:
        """Knot times, and coefficients (pieces, 4, 3) of the powers 3, 2, 1, 0 of the time since each piece's knot."""
        from scipy.interpolate import CubicSpline  # pyright: ignore  - slow to import

        times, places = list(self.times), np.array(self.places, dtype=np.float64)
        if times[0] > 0.0:
            times, places = [0.0, *times], np.concatenate((np.zeros((1, 3)), places))
        if len(times) == 1:
            return times, np.zeros((1, 4, 3))
        spline: Any = cast(Any, CubicSpline)(times, places, bc_type="clamped")
        return times, np.ascontiguousarray(np.moveaxis(spline.c, 1, 0))

    def _check_limits(self) -> None:
        """Raise an error for the first piece of the spline that is too fast; all pieces are computed at once."""
        knots, pieces = self._spline
        c3, c2, c1, _ = pieces[: len(knots) - 1].transpose(1, 2, 0)[:, :, None]  # (3, 1, pieces) each
        # The acceleration is largest at an end of a spline piece; the speed is sampled finely.
        since = np.linspace(0.0, np.diff(knots), 33)
        accelerations = np.linalg.norm(6.0 * c3 * since[[0, -1]] + 2.0 * c2, axis=0)
        speeds = np.linalg.norm((3.0 * c3 * since + 2.0 * c2) * since + c1, axis=0)
        jerky = accelerations > self.max_acceleration * (1.0 + 1e-9)
        fast = speeds > self.max_speed * (1.0 + 1e-9)
        broken = np.flatnonzero(jerky.any(axis=0) | fast.any(axis=0))
        if len(broken) == 0:
            return
        piece = int(broken[0])
        if jerky[:, piece].any():
            at = int(jerky[:, piece].argmax())
            what = f"acceleration {accelerations[at, piece]:.3g} m/s^2 at {knots[piece + at]:.4g} s"
            limit = f"{self.max_acceleration:g} m/s^2"
        else:
            at = int(speeds[:, piece].argmax())
            what = f"speed {speeds[at, piece]:.3g} m/s at {knots[piece] + since[at, piece]:.4g} s"
            limit = f"{self.max_speed:g} m/s"
        # A violation between two waypoints is reported for the second one.
        text = f"waypoints: {what} is above {limit}; give the points around it more time"
        raise DescriptionError(text).at(knots[piece + 1])

    def setpoint(self, time: float) -> Setpoint:
        """Return a point of the spline; after the last time, return the last waypoint."""
        knots, pieces = self._spline
        if time >= knots[-1]:
            return Setpoint(np.array(self.places[-1], dtype=np.float64), np.zeros(3))
        piece = max(bisect.bisect_right(knots, time) - 1, 0)
        since = max(time, 0.0) - knots[piece]
        c3, c2, c1, c0 = pieces[piece]
        return Setpoint(((c3 * since + c2) * since + c1) * since + c0, (3.0 * c3 * since + 2.0 * c2) * since + c1)


def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rotated(direction: Array, rotation: Array) -> Array:
    """Return a direction (3,) after a small rotation (3,), axis times angle [rad].

    The function is not compiled, so that its first call takes no compilation time.
    """
    there = direction + _cross(rotation, direction)
    return there / math.sqrt(float(there @ there))


def _unit(what: str, direction: tuple[float, float, float]) -> Array:
    vector = np.array(direction, dtype=np.float64)
    if vector.shape != (3,) or not MIN_DIRECTION <= math.hypot(*direction) <= MAX_DIRECTION:
        raise DescriptionError(
            f"{what}: direction {direction} has no length; give three numbers, not all zero, whose length is"
            f" {MIN_DIRECTION:g} ... {MAX_DIRECTION:g}"
        )
    return vector / float(np.linalg.norm(vector))
