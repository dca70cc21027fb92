"""Where the tip should be: offsets from the tip at the start, and their velocity.

Every motion starts at offset zero, where the tip is. A motion with a `period` repeats itself; what is
true of one period is true for ever.
"""

import bisect
import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from core.errors import DescriptionError
from core.robot.robot import Array

STILL = np.zeros(3)


class Setpoint(NamedTuple):
    """Desired tip relative to the tip at the start, world frame."""

    position: Array  #: (3,) [m]
    velocity: Array  #: (3,) [m/s]
    direction: Array | None = None  #: (3,) in which the tip points, unit vector; None keeps that of the start
    turning: Array = STILL  #: (3,) its angular velocity [rad/s]


class JointMotion(NamedTuple):
    """Joint velocities asked for directly: approach, jog, a sweep of one joint."""

    velocity: Array  #: (n,) [rad/s or m/s]


class Trajectory(Protocol):
    """A motion of the tip over time."""

    @property
    def period(self) -> float:
        """Time after which it repeats itself or stands still for good [s]."""
        ...

    def setpoint(self, time: float) -> Setpoint:
        """Desired offset and velocity at `time` [s] from the start."""
        ...


#: Between two waypoints [s].
CLOSEST = 1e-3


@dataclass(frozen=True)
class Directions:
    """Where the tip points over time: from one direction to the next about one axis, at rest at each of them."""

    times: tuple[float, ...]  #: rising [s]
    directions: tuple[tuple[float, float, float], ...]  #: of any length but zero, none opposite to the one before

    def __post_init__(self) -> None:
        if not self.times or len(self.times) != len(self.directions):
            raise DescriptionError(
                f"directions: {len(self.times)} times and {len(self.directions)} directions; give one each"
            )
        for before, after in zip(self.times, self.times[1:], strict=False):
            if not after - before >= CLOSEST:
                raise DescriptionError(
                    f"directions: {after:g} s does not come {1e3 * CLOSEST:g} ms or more after {before:g} s"
                )
        for first, second in itertools.pairwise(self._units):
            if float(first @ second) < -0.999:
                raise DescriptionError("directions: two that follow are opposite; say by which way to turn")

    @cached_property
    def _units(self) -> list[Array]:
        return [_unit("directions", direction) for direction in self.directions]

    def at(self, time: float) -> tuple[Array, Array]:
        """Direction (3,) and its angular velocity (3,) [rad/s] at `time` [s]."""
        after = bisect.bisect_right(self.times, time)
        if after == 0 or after == len(self.times):
            return self._units[max(0, after - 1)], STILL
        first, second = self._units[after - 1 : after + 1]
        length = self.times[after] - self.times[after - 1]
        axis, part = _cross(first, second), math.pi * (time - self.times[after - 1]) / length
        sin = float(np.linalg.norm(axis))
        whole = math.atan2(sin, float(first @ second))
        if whole < 1e-9:
            return first, STILL
        axis /= sin
        angle, rate = whole * 0.5 * (1.0 - math.cos(part)), whole * 0.5 * math.pi / length * math.sin(part)
        return first * math.cos(angle) + _cross(axis, first) * math.sin(angle), axis * rate


@dataclass(frozen=True)
class Hold:
    """Stay at the start tip (regulation)."""

    @property
    def period(self) -> float:
        """0: the tip never moves, so nothing repeats [s]."""
        return 0.0

    def setpoint(self, time: float) -> Setpoint:  # noqa: ARG002 - the same at any time
        """Zero at any time."""
        return Setpoint(np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class Step:
    """From the start tip to another place at once; back again, and so on, when a time to stay is given."""

    offset: tuple[float, float, float]  #: [m]
    stay: float = math.inf  #: at either place [s]

    def __post_init__(self) -> None:
        if not all(math.isfinite(part) for part in self.offset):
            raise DescriptionError(f"step: offset {self.offset} m is not finite")
        if not self.stay > 0.0:
            raise DescriptionError(f"step: stay {self.stay:g} s must be greater than 0")

    @property
    def period(self) -> float:
        """It stands at once, and where it stands is all that matters."""
        return 0.0

    def setpoint(self, time: float) -> Setpoint:
        """Either place; the velocity is zero but for single moments."""
        there = math.isinf(self.stay) or int(time / self.stay) % 2 == 0
        return Setpoint(np.array(self.offset) if there else np.zeros(3), np.zeros(3))


@dataclass(frozen=True)
class Sinusoid:
    """Back and forth along a line through the start tip."""

    direction: tuple[float, float, float]  #: any length but zero
    amplitude: float  #: [m]
    frequency: float  #: [Hz]

    def __post_init__(self) -> None:
        _positive("sinusoid", self.amplitude, "amplitude", "m")
        _positive("sinusoid", self.frequency, "frequency", "Hz")
        _unit("sinusoid", self.direction)

    @property
    def period(self) -> float:
        """Of one oscillation [s]."""
        return 1.0 / self.frequency

    @cached_property
    def _axis(self) -> Array:
        return _unit("sinusoid", self.direction)

    def setpoint(self, time: float) -> Setpoint:
        """Amplitude * sin(2 pi f t) along the direction."""
        axis, rate = self._axis, 2.0 * math.pi * self.frequency
        return Setpoint(
            axis * (self.amplitude * math.sin(rate * time)), axis * (self.amplitude * rate * math.cos(rate * time))
        )


@dataclass(frozen=True)
class Circle:
    """A circle through the start tip, in the plane of two directions, at constant speed."""

    radius: float  #: [m]
    period: float  #: [s]
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)  #: axis of the circle

    def __post_init__(self) -> None:
        _positive("circle", self.radius, "radius", "m")
        _positive("circle", self.period, "period", "s")
        _unit("circle", self.normal)

    @cached_property
    def _plane(self) -> tuple[Array, Array]:
        return _plane(_unit("circle", self.normal))

    def setpoint(self, time: float) -> Setpoint:
        """Starts at offset zero; the centre lies `radius` away, square to the normal."""
        first, second = self._plane
        rate = 2.0 * math.pi / self.period
        cos, sin = math.cos(rate * time), math.sin(rate * time)
        return Setpoint(
            first * (self.radius * (cos - 1.0)) + second * (self.radius * sin),
            second * (self.radius * rate * cos) - first * (self.radius * rate * sin),
        )


@dataclass(frozen=True)
class Helix:
    """Turns about an axis while it advances along it, at constant speed, to the end of its last turn."""

    radius: float  #: [m]
    pitch: float  #: advance in one turn, either way [m]
    turn: float  #: time for one turn [s]
    turns: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _positive("helix", self.radius, "radius", "m")
        _positive("helix", self.turn, "turn", "s")
        _positive("helix", self.turns, "turns", "")
        if not math.isfinite(self.pitch):
            raise DescriptionError(f"helix: pitch {self.pitch:g} m is not finite")
        _unit("helix", self.axis)

    @property
    def period(self) -> float:
        """Until it stands still [s]."""
        return self.turns * self.turn

    @cached_property
    def _axis(self) -> Array:
        return _unit("helix", self.axis)

    @cached_property
    def _circle(self) -> Circle:
        return Circle(self.radius, self.turn, self.axis)

    def setpoint(self, time: float) -> Setpoint:
        """Starts at offset zero, as the circle does."""
        if time >= self.period:
            return Setpoint(self._at(self.period).position, np.zeros(3))
        return self._at(time)

    def _at(self, time: float) -> Setpoint:
        round_, speed = self._circle.setpoint(time), self._axis * (self.pitch / self.turn)
        return Setpoint(round_.position + speed * time, round_.velocity + speed)


@dataclass(frozen=True)
class Waypoints:
    """Through given places at given times, smoothly: a cubic spline from rest at the start tip to rest at the last.

    The way from the start tip to the first place is the approach; the first time says how long it takes.
    """

    times: tuple[float, ...]  #: rising, the first above 0 unless its place is the start tip [s]
    places: tuple[tuple[float, float, float], ...]  #: offsets from the start tip [m]
    max_speed: float = 0.02  #: of the tip [m/s]
    max_acceleration: float = 0.1  #: [m/s^2]

    def __post_init__(self) -> None:
        _positive("waypoints", self.max_speed, "max_speed", "m/s")
        _positive("waypoints", self.max_acceleration, "max_acceleration", "m/s^2")
        if not self.times or len(self.times) != len(self.places):
            raise DescriptionError(f"waypoints: {len(self.times)} times and {len(self.places)} places; give one each")
        for number, (time, place) in enumerate(zip(self.times, self.places, strict=True), 1):
            if not (math.isfinite(time) and len(place) == 3 and all(math.isfinite(part) for part in place)):
                raise DescriptionError(
                    f"waypoints: number {number} at {time} s, {place} m: finite numbers are needed"
                ).at(time)
        if self.times[0] < 0.0 or (self.times[0] == 0.0 and any(self.places[0])):
            raise DescriptionError(
                f"waypoints: the first, {self.places[0]} m from the start tip, at {self.times[0]:g} s;"
                " give it a time above 0 s for the way there"
            ).at(self.times[0])
        for before, after in zip(self.times, self.times[1:], strict=False):
            if not after > before:
                raise DescriptionError(f"waypoints: time {after:g} s does not come after {before:g} s").at(after)
        for before, after in zip((0.0, *self.times), self.times, strict=False):
            # Nearer ones overflow the spline's coefficients, and nothing compares with what is no number.
            if 0.0 < after - before < CLOSEST:
                raise DescriptionError(
                    f"waypoints: {after:g} s is less than {1e3 * CLOSEST:g} ms after {before:g} s; give it more time"
                ).at(after)
        self._check_limits()

    @property
    def period(self) -> float:
        """Until it stands still [s]."""
        return self.times[-1]

    @cached_property
    def _spline(self) -> tuple[list[float], Array]:
        """Knots and coefficients (pieces, 4, 3): position of powers 3, 2, 1, 0 of the time since the knot."""
        from scipy.interpolate import CubicSpline  # pyright: ignore  - slow to import

        times, places = list(self.times), np.array(self.places, dtype=np.float64)
        if times[0] > 0.0:
            times, places = [0.0, *times], np.concatenate((np.zeros((1, 3)), places))
        if len(times) == 1:
            return times, np.zeros((1, 4, 3))
        spline: Any = cast(Any, CubicSpline)(times, places, bc_type="clamped")
        return times, np.ascontiguousarray(np.moveaxis(spline.c, 1, 0))

    def _check_limits(self) -> None:
        knots, pieces = self._spline
        # What is wrong on the way to a place is told of that place.
        for start, end, (c3, c2, c1, _) in zip(knots, knots[1:], pieces, strict=False):
            # Acceleration is largest at an end of a piece; speed is looked at finely.
            for time in (0.0, end - start):
                acceleration = float(np.linalg.norm(6.0 * c3 * time + 2.0 * c2))
                if acceleration > self.max_acceleration * (1.0 + 1e-9):
                    raise DescriptionError(
                        f"waypoints: acceleration {acceleration:.3g} m/s^2 at {start + time:.4g} s is above"
                        f" {self.max_acceleration:g} m/s^2; give the points around it more time"
                    ).at(end)
            since = np.linspace(0.0, end - start, 33)[:, None]
            speeds = np.linalg.norm((3.0 * c3 * since + 2.0 * c2) * since + c1, axis=1)
            if speeds.max() > self.max_speed * (1.0 + 1e-9):
                raise DescriptionError(
                    f"waypoints: speed {speeds.max():.3g} m/s at {start + since[speeds.argmax(), 0]:.4g} s is above"
                    f" {self.max_speed:g} m/s; give the points around it more time"
                ).at(end)

    def setpoint(self, time: float) -> Setpoint:
        """On the spline; at the last place after the last time."""
        knots, pieces = self._spline
        if time >= knots[-1]:
            return Setpoint(np.array(self.places[-1], dtype=np.float64), np.zeros(3))
        piece = max(bisect.bisect_right(knots, time) - 1, 0)
        since = max(time, 0.0) - knots[piece]
        c3, c2, c1, c0 = pieces[piece]
        return Setpoint(((c3 * since + c2) * since + c1) * since + c0, (3.0 * c3 * since + 2.0 * c2) * since + c1)


def _positive(what: str, value: float, name: str, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise DescriptionError(f"{what}: {name} {value:g} {unit} must be finite and greater than 0")


def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _plane(normal: Array) -> tuple[Array, Array]:
    """Two directions square to the normal and to each other; the axis least along the normal gives the first."""
    first = _cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    first /= np.linalg.norm(first)
    return first, _cross(normal, first)


def turned(direction: Array, way: Array) -> Array:
    """A direction (3,) after a small turn (3,), axis times angle [rad]; plain: no motion waits for a compiler."""
    there = direction + _cross(way, direction)
    return there / math.sqrt(float(there @ there))


def _unit(what: str, direction: tuple[float, float, float]) -> Array:
    vector = np.array(direction, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not math.isfinite(length) or length < 1e-9:
        raise DescriptionError(f"{what}: direction {direction} has no length; give three numbers, not all zero")
    return vector / length
