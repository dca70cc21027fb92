"""Simulated loads: forces at the robot's tip or on its shaft. Gravity points along +x.

The force of most loads is a function of time. A wall or a sphere is an obstacle: its force follows from the true tip,
and `station.lab.tip_contact` computes it together with the shape of the plant.
"""

import bisect
import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Self, get_args

import numpy as np
from pydantic import Field, model_validator

from core.contract import name_of, numbers, result_of
from core.errors import CtrError
from core.robot.robot import Array
from station.config.plugins import Setup, made
from station.config.strict import Direction, NotNegative, Position, Strict

GRAVITY = (1.0, 0.0, 0.0)
#: Largest force of a load [N]: the base sensors saturate at 18 N, and nitinol tubes of a millimetre bear much less.
MAX_FORCE_N = 20.0
Force = Annotated[float, Field(ge=0.0, le=MAX_FORCE_N)]
SignedForce = Annotated[float, Field(ge=-MAX_FORCE_N, le=MAX_FORCE_N)]
#: Bounds of the frequencies [Hz] and durations [s] of a load. Inside them the formulas of all loads are accurate.
Frequency = Annotated[float, Field(ge=1e-3, le=100.0)]
Time = Annotated[float, Field(ge=0.01, le=1e5)]
#: Largest number of points between which a load changes linearly.
MAX_POINTS = 10_000


@lru_cache(maxsize=64)
def _unit(direction: tuple[float, float, float]) -> Array:
    unit = np.array(direction) / math.hypot(*direction)
    unit.flags.writeable = False
    return unit


class _AtTip(Strict):
    @property
    def contact(self) -> float:
        """Arc length from the plate to the point of application [m]; inf for the tip."""
        return math.inf

    @property
    def changes(self) -> tuple[float, ...]:
        """Times at which the load starts to change after being constant [s]; the first is its onset; empty: never."""
        return (0.0,)

    @property
    def onset(self) -> float:
        """Time at which the load starts [s]; inf for never."""
        return next(iter(self.changes), math.inf)


class _Directed(_AtTip):
    direction: Direction = GRAVITY
    """direction of the force, world frame; its length does not matter"""

    def _along(self, magnitude: float) -> Array:
        return magnitude * _unit(self.direction)


class NoLoad(_AtTip):
    """No load."""

    kind: Literal["none"] = "none"

    @property
    def changes(self) -> tuple[float, ...]:
        """Times at which the load starts to change: none."""
        return ()

    def force(self, time: float) -> Array:  # noqa: ARG002 - none at any time
        """Return the force (3,) [N]: zero."""
        return np.zeros(3)


class ConstantLoad(_Directed):
    """A constant weight."""

    kind: Literal["constant"] = "constant"
    magnitude: Force
    """force of the weight [N]"""

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        return self._along(self.magnitude if time >= 0.0 else 0.0)


class SineLoad(_Directed):
    """A sinusoidal load: amplitude * sin(2 pi frequency t)."""

    kind: Literal["sine"] = "sine"
    amplitude: Force
    """largest force, in both directions [N]"""
    frequency: Frequency
    """frequency of the sine wave [Hz]"""

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        return self._along(self.amplitude * math.sin(2.0 * math.pi * self.frequency * max(time, 0.0)))


class RaisedCosineLoad(_Directed):
    """A periodic load from 0 to `peak` and back: peak / 2 (1 - cos(2 pi t / period))."""

    kind: Literal["raised_cosine"] = "raised_cosine"
    peak: Force
    """largest force, in the middle of each period [N]"""
    period: Time
    """duration of a period, from zero force to zero force [s]"""

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        return self._along(0.5 * self.peak * (1.0 - math.cos(2.0 * math.pi * max(time, 0.0) / self.period)))


class RampLoad(_Directed):
    """Linear ramps between points in time; constant after the last."""

    kind: Literal["ramps"] = "ramps"
    times: tuple[NotNegative, ...] = Field(min_length=1, max_length=MAX_POINTS, strict=False, fail_fast=True)
    """times of the points, increasing [s]"""
    magnitudes: tuple[SignedForce, ...] = Field(max_length=MAX_POINTS, strict=False, fail_fast=True)
    """forces at the points, one for each time; a negative force is opposite to `direction` [N]"""

    @model_validator(mode="after")
    def _match(self) -> Self:
        if len(self.times) != len(self.magnitudes):
            raise ValueError(f"{len(self.times)} times but {len(self.magnitudes)} magnitudes; give one for each time")
        if any(b <= a for a, b in zip(self.times, self.times[1:], strict=False)):
            raise ValueError("times must increase")
        return self

    @property
    def changes(self) -> tuple[float, ...]:
        """Times at which the load starts to change after being constant, or jumps from zero [s]."""
        moves = [a != b for a, b in zip((0.0, *self.magnitudes), self.magnitudes, strict=False)]  # up to each point
        jump = self.times[:1] if moves[0] else ()
        corners = zip(self.times, moves, (*moves[1:], False), strict=True)
        return (*jump, *(time for time, until, after in corners if after and not until))

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before the first point."""
        after = bisect.bisect_right(self.times, time)
        if after == 0:
            return np.zeros(3)
        if after == len(self.times):
            return self._along(self.magnitudes[-1])
        (t0, t1), (f0, f1) = self.times[after - 1 : after + 1], self.magnitudes[after - 1 : after + 1]
        return self._along(f0 + (f1 - f0) * (time - t0) / (t1 - t0))


class TrapezoidLoad(_Directed):
    """A load that rises linearly, stays constant and falls linearly; rise and fall of 0 s make a step."""

    kind: Literal["trapezoid"] = "trapezoid"
    magnitude: Force
    """force while the load is constant [N]"""
    rise: NotNegative
    """duration of the rise [s]; 0 for a step"""
    fall: NotNegative = 0.0
    """duration of the fall [s]; 0 for a step"""
    stay: NotNegative | None = None
    """duration of the constant load [s]; default: unlimited"""
    start: NotNegative = 0.0
    """start time of the rise [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """Start times of the rise and of the fall [s]."""
        return (self.start,) if self.stay is None else (self.start, self._off)

    @property
    def _off(self) -> float:
        """Start time of the fall [s]."""
        return math.inf if self.stay is None else self.start + self.rise + self.stay

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        on = _ramp_share(time - self.start, self.rise)
        return self._along(self.magnitude * (on - _ramp_share(time - self._off, self.fall)))


class TapLoad(_Directed):
    """A tap with a finger: half a sine wave."""

    kind: Literal["tap"] = "tap"
    peak: Force
    """largest force, in the middle of the tap [N]"""
    duration: Time = 0.05
    """duration of the tap [s]"""
    start: NotNegative = 0.0
    """start time of the tap [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """Start time of the tap [s]."""
        return (self.start,)

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before and after the tap."""
        part = min(max((time - self.start) / self.duration, 0.0), 1.0)
        return self._along(self.peak * max(math.sin(math.pi * part), 0.0))


def _ramp_share(time: float, length: float) -> float:
    """Return 0 before time 0, 1 after `length` [s], and a linear ramp between; a step for length 0."""
    if time < 0.0:
        return 0.0
    return 1.0 if time >= length else time / length


class HungWeightLoad(_Directed):
    """A weight lowered on a rubber band: it oscillates at the natural frequency of the band.

    The tip's motion is small compared with the band's stretch and is neglected.
    """

    kind: Literal["hung_weight"] = "hung_weight"
    weight: Force
    """force of the weight at rest [N]"""
    lowering: Time = 2.0
    """duration of the lowering by hand [s]"""
    frequency: Frequency = 2.0
    """natural frequency of the weight on the band [Hz]"""
    damping: Annotated[float, Field(ge=1e-3, le=0.999)] = 0.05
    """damping of the oscillation, as a fraction of critical damping"""
    start: NotNegative = 0.0
    """start time of the lowering [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """Start time of the lowering [s]."""
        return (self.start,)

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before the lowering starts."""
        time -= self.start
        return self._along(
            self.weight * (self._step_integral(time) - self._step_integral(time - self.lowering)) / self.lowering
        )

    def _step_integral(self, time: float) -> float:
        """Return the integral of the oscillator's step response [s]."""
        if time <= 0.0:
            return 0.0
        rate = 2.0 * math.pi * self.frequency
        a, b = self.damping * rate, math.sqrt(1.0 - self.damping**2) * rate
        swing = (b - a * a / b) * math.sin(b * time) - 2.0 * a * math.cos(b * time)
        return time - (2.0 * a + math.exp(-a * time) * swing) / (rate * rate)


class AllAroundLoad(_AtTip):
    """A constant force whose direction covers the sphere: it moves from +z to -z while it rotates about z."""

    kind: Literal["all_around"] = "all_around"
    magnitude: Force
    """size of the force, the same in every direction [N]"""
    period: Time
    """duration of the motion from one pole to the other [s]; the force then moves back along the same path"""
    turns: Annotated[float, Field(ge=0.0, le=100.0)] = 2.0
    """number of turns about z from pole to pole"""
    ramp: Time = 5.0
    """duration of the initial ramp [s]"""

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        down, around = math.pi * time / self.period, 2.0 * math.pi * self.turns * time / self.period
        size = self.magnitude * _ramp_share(time, self.ramp)
        across = size * math.sin(down)
        return np.array([across * math.cos(around), across * math.sin(around), size * math.cos(down)])


class ContactLoad(_Directed):
    """A contact force on the shaft."""

    kind: Literal["contact"] = "contact"
    magnitude: Force
    """size of the force [N]"""
    place: NotNegative
    """arc length from the front plate to the contact [m]"""

    @property
    def contact(self) -> float:
        """Arc length of the contact [m]."""
        return self.place

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        return self._along(self.magnitude if time >= 0.0 else 0.0)


class Depth(NamedTuple):
    """Depth of a tip in an obstacle, and the direction out of the obstacle."""

    depth: float  #: depth of the tip below the surface; negative outside the obstacle [m]
    normal: Array  #: (3,) unit normal of the surface, which points out of the obstacle


class Spot(NamedTuple):
    """Additional stiffness of an obstacle at a point of its surface, and its derivatives along the surface."""

    stiffness: float  #: additional normal force per depth [N/m]
    gradient: Array  #: (3,) first derivative [N/m^2]
    curvature: Array  #: (3, 3) second derivative [N/m^3]


class _Obstacle(_AtTip):
    """An obstacle that the tip touches: elastic normal force, damping and friction."""

    stiffness: Annotated[float, Field(ge=1.0, le=1e5)] = 1000.0
    """normal force per depth of the tip below the surface [N/m]; tissue has about 100 to 500 N/m"""
    damping: Annotated[float, Field(ge=0.0, le=1e3)] = 0.0
    """normal force per rate of the depth, which makes the obstacle a Kelvin-Voigt solid [N s/m]"""
    friction: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0
    """coefficient of friction between tip and surface"""

    @property
    def changes(self) -> tuple[float, ...]:
        """Times at which the load starts to change: unknown, because they depend on the tip."""
        return ()

    def force(self, time: float) -> Array:  # noqa: ARG002 - none at any time
        """Return the force (3,) [N] of an obstacle that the tip does not touch: zero."""
        return np.zeros(3)

    def spot(self, offset: Array) -> Spot | None:  # noqa: ARG002 - the same everywhere
        """Return the additional stiffness below a tip at `offset` (3,) [m] from its start; None: uniform stiffness."""
        return None


class WallLoad(_Obstacle):
    """A flat wall, which may move along its normal; with damping it is a Kelvin-Voigt tissue.

    With a lump it is a tissue that is stiffer above an inclusion: a bed of independent springs with the energy
    k(s) d^2 / 2, where d is the depth of the tip and s its position on the surface. The force is the negative gradient
    of the energy, so it also pushes the tip from the lump toward softer places, by k'(s) d^2 / 2.
    """

    kind: Literal["wall"] = "wall"
    direction: Direction = (0.0, 0.0, -1.0)
    """normal of the wall, which points out of the wall toward the tip, world frame; its length does not matter"""
    distance: Annotated[float, Field(ge=-0.05, le=0.1)] = 0.005
    """distance of the wall from the tip at the motion's start; negative if the tip starts below the surface [m]"""
    motion: Literal["sine", "heartbeat"] = "sine"
    """motion of the wall along its normal: `sine`, or `heartbeat`: it advances and returns in 0.35 of each period"""
    amplitude: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    """largest displacement of the moving wall, 0 for a wall at rest [m]"""
    frequency: Annotated[float, Field(ge=0.01, le=5.0)] = 0.25
    """frequency of the wall's motion [Hz]"""
    lump_stiffness: Annotated[float, Field(ge=0.0, le=1e4)] = 0.0
    """additional normal force per depth above the center of a stiff lump in the wall, 0 without a lump [N/m]"""
    lump_center: Position = (0.0, 0.0, 0.0)
    """center of the lump relative to the tip at the motion's start; only its part across `direction` counts [m]"""
    lump_radius: Annotated[float, Field(gt=0.0, le=0.1)] = 0.004
    """distance from the center at which the additional stiffness has decreased to 1 / e [m]"""

    @property
    def without_effect(self) -> frozenset[str]:
        """Keys without effect: those of the motion of a wall at rest, and those of a missing lump."""
        motion = {"motion", "amplitude", "frequency"} if self.amplitude == 0.0 else set[str]()
        lump = {"lump_stiffness", "lump_center", "lump_radius"} if self.lump_stiffness == 0.0 else set[str]()
        return frozenset(motion | lump)

    def displacement(self, time: float) -> float:
        """Return the displacement of the wall along its normal [m] at `time` [s] since the motion's start."""
        turns = self.frequency * max(time, 0.0)
        if self.motion == "sine":
            return self.amplitude * math.sin(2.0 * math.pi * turns)
        beat = min((turns - math.floor(turns)) / BEAT_SHARE, 1.0)
        return self.amplitude * math.sin(math.pi * beat) ** 2

    def depth(self, offset: Array, time: float) -> Depth:
        """Return the depth of a tip at `offset` (3,) [m] from its start, at `time` [s] since the motion's start."""
        normal = _unit(self.direction)
        return Depth(self.displacement(time) - self.distance - float(normal @ offset), normal)

    def spot(self, offset: Array) -> Spot | None:
        """Return the additional stiffness of the lump below a tip at `offset` (3,) [m] from its start."""
        if self.lump_stiffness == 0.0:
            return None
        normal, away = _unit(self.direction), offset - np.array(self.lump_center)
        across = np.eye(3) - np.outer(normal, normal)
        away = across @ away / self.lump_radius
        size = self.lump_stiffness * math.exp(-float(away @ away))
        gradient = -2.0 * size / self.lump_radius * away
        curvature = 2.0 * size / self.lump_radius**2 * (2.0 * np.outer(away, away) - across)
        return Spot(size, gradient, curvature)


class SphereLoad(_Obstacle):
    """A soft sphere at rest, which the tip palpates from outside."""

    kind: Literal["sphere"] = "sphere"
    center: Position
    """center of the sphere relative to the tip at the motion's start [m]"""
    radius: Annotated[float, Field(gt=0.0, le=0.5)]
    """radius of the sphere [m]"""

    def depth(self, offset: Array, time: float) -> Depth:  # noqa: ARG002 - at rest
        """Return the depth of a tip at `offset` (3,) [m] from its start; a tip at the center is pushed along +z."""
        away = offset - np.array(self.center)
        distance = float(np.linalg.norm(away))
        return Depth(self.radius - distance, away / distance if distance > 0.0 else np.array([0.0, 0.0, 1.0]))


#: Part of each period in which a wall with the motion `heartbeat` moves; it rests during the other part.
BEAT_SHARE = 0.35
#: Loads whose force depends on the tip.
Obstacle = WallLoad | SphereLoad


def elastic_force(obstacle: Obstacle, offset: Array) -> Array:
    """Return the force (3,) [N] of an obstacle at rest, without friction, on a tip at `offset` (3,) [m] from its start.

    `station.lab.tip_contact` adds damping, friction and the motion of the obstacle.
    """
    depth, normal = obstacle.depth(offset, 0.0)
    if depth <= 0.0:
        return np.zeros(3)
    if (spot := obstacle.spot(offset)) is None:
        return obstacle.stiffness * depth * normal
    return (obstacle.stiffness + spot.stiffness) * depth * normal - 0.5 * depth * depth * spot.gradient


class InstalledLoad(_AtTip):
    """A load of an installed package, at the tip."""

    kind: Literal["installed"] = "installed"
    name: str
    """name of its entry point of the group ctr_station.loads"""
    options: Mapping[str, Any] = {}
    """keys of the installed load"""

    @model_validator(mode="after")
    def _is_installed(self) -> Self:
        try:
            result_of(f"load '{self.name}'", self._own.force, 0.0)
        except CtrError as error:
            raise ValueError(str(error)) from error
        return self

    @cached_property
    def _own(self) -> Any:
        return made("loads", self.name, "name", Setup(self.options))

    def force(self, time: float) -> Array:
        """Return the force (3,) [N] at `time` [s] since the motion's start; zero before."""
        return self._own.force(time) if time >= 0.0 else np.zeros(3)


Load = Annotated[
    NoLoad
    | ConstantLoad
    | SineLoad
    | RaisedCosineLoad
    | RampLoad
    | TrapezoidLoad
    | TapLoad
    | HungWeightLoad
    | AllAroundLoad
    | ContactLoad
    | WallLoad
    | SphereLoad
    | InstalledLoad,
    Field(discriminator="kind"),
]


#: Loads whose forces need no check: their values were checked when the load was read.
_OWN_LOADS = frozenset(get_args(get_args(Load)[0])) - {InstalledLoad}


def force_of(load: Load, time: float) -> Array:
    """Return the force (3,) [N] of a load at `time` [s] since the motion's start; that of an obstacle is zero here.

    Raises:
        ContractError: a custom load raised, or returned something other than three finite numbers.
    """
    if type(load) in _OWN_LOADS:
        return load.force(time)
    who = f"load '{load.name if isinstance(load, InstalledLoad) else name_of(load)}'"
    return numbers(who, "the force", result_of(who, load.force, time), (3,), "N")
