"""Where the tip should be: offsets from the tip at the start, and their velocity."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from core.errors import DescriptionError
from core.robot import Array


class Setpoint(NamedTuple):
    """Desired tip relative to the tip at the start, world frame."""

    position: Array  #: (3,) [m]
    velocity: Array  #: (3,) [m/s]


class JointMotion(NamedTuple):
    """Joint velocities asked for directly: approach, jog, a sweep of one joint."""

    velocity: Array  #: (n,) [rad/s or m/s]


class Trajectory(Protocol):
    """A motion of the tip over time."""

    def setpoint(self, time: float) -> Setpoint:
        """Desired offset and velocity at `time` [s] from the start."""
        ...


@dataclass(frozen=True)
class Hold:
    """Stay at the start tip (regulation)."""

    def setpoint(self, time: float) -> Setpoint:  # noqa: ARG002 - the same at any time
        """Zero at any time."""
        return Setpoint(np.zeros(3), np.zeros(3))


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

    def setpoint(self, time: float) -> Setpoint:
        """Amplitude * sin(2 pi f t) along the direction."""
        axis, rate = _unit("sinusoid", self.direction), 2.0 * math.pi * self.frequency
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

    def setpoint(self, time: float) -> Setpoint:
        """Starts at offset zero; the centre lies `radius` away, square to the normal."""
        normal = _unit("circle", self.normal)
        # The axis least along the normal gives the plane's first direction.
        first = _cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        first /= np.linalg.norm(first)
        second = _cross(normal, first)
        rate = 2.0 * math.pi / self.period
        cos, sin = math.cos(rate * time), math.sin(rate * time)
        return Setpoint(
            first * (self.radius * (cos - 1.0)) + second * (self.radius * sin),
            second * (self.radius * rate * cos) - first * (self.radius * rate * sin),
        )


def _positive(what: str, value: float, name: str, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise DescriptionError(f"{what}: {name} {value:g} {unit} must be finite and greater than 0")


def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(what: str, direction: tuple[float, float, float]) -> Array:
    vector = np.array(direction, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not math.isfinite(length) or length < 1e-9:
        raise DescriptionError(f"{what}: direction {direction} has no length; give three numbers, not all zero")
    return vector / length
