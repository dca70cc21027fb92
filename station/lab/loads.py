"""What pulls at the tip, as a force over time. Gravity points along +x."""

import bisect
import math
from functools import lru_cache
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from core.robot.robot import Array
from station.config.strict import Direction, NotNegative, Row, Strict

GRAVITY = (1.0, 0.0, 0.0)
#: The base sensors saturate at 18 N; nothing that a millimetre of nitinol is asked to bear comes near it [N].
MOST = 20.0
Force = Annotated[float, Field(ge=0.0, le=MOST)]
SignedForce = Annotated[float, Field(ge=-MOST, le=MOST)]
#: Beyond these nothing is left of a number in the formulas below.
Frequency = Annotated[float, Field(ge=1e-3, le=100.0)]
Time = Annotated[float, Field(ge=0.01, le=1e5)]


@lru_cache(maxsize=64)
def _unit(direction: tuple[float, float, float]) -> Array:
    unit = np.array(direction) / math.hypot(*direction)
    unit.flags.writeable = False
    return unit


class _AtTip(Strict):
    @property
    def contact(self) -> float:
        """Arc length from the plate at which it acts [m]; inf for the tip."""
        return math.inf

    @property
    def changes(self) -> tuple[float, ...]:
        """When it begins to change after it has stood still [s], the first time being its onset; empty: never."""
        return (0.0,)

    @property
    def onset(self) -> float:
        """When it first pulls [s]; inf for never."""
        return next(iter(self.changes), math.inf)


class _Directed(_AtTip):
    direction: Direction = GRAVITY
    """in which it pulls, world frame; its length does not matter"""

    def _along(self, magnitude: float) -> Array:
        return magnitude * _unit(self.direction)


class NoLoad(_AtTip):
    """Nothing."""

    kind: Literal["none"] = "none"

    @property
    def changes(self) -> tuple[float, ...]:
        """Never."""
        return ()

    def force(self, time: float) -> Array:  # noqa: ARG002 - none at any time
        """(3,) [N]."""
        return np.zeros(3)


class ConstantLoad(_Directed):
    """A weight that always hangs."""

    kind: Literal["constant"] = "constant"
    magnitude: Force
    """of the weight [N]"""

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        return self._along(self.magnitude if time >= 0.0 else 0.0)


class SineLoad(_Directed):
    """amplitude * sin(2 pi frequency t)."""

    kind: Literal["sine"] = "sine"
    amplitude: Force
    """to either side [N]"""
    frequency: Frequency
    """there and back in a second [Hz]"""

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        return self._along(self.amplitude * math.sin(2.0 * math.pi * self.frequency * max(time, 0.0)))


class RaisedCosineLoad(_Directed):
    """Up to `peak` and back every period, starting from nothing: peak / 2 (1 - cos(2 pi t / period))."""

    kind: Literal["raised_cosine"] = "raised_cosine"
    peak: Force
    """largest pull, in the middle of each period [N]"""
    period: Time
    """from nothing to nothing [s]"""

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        return self._along(0.5 * self.peak * (1.0 - math.cos(2.0 * math.pi * max(time, 0.0) / self.period)))


class RampLoad(_Directed):
    """Straight lines between points in time; constant after the last."""

    kind: Literal["ramps"] = "ramps"
    times: tuple[NotNegative, ...] = Field(min_length=1, strict=False)
    """rising [s]"""
    magnitudes: Annotated[tuple[SignedForce, ...], Row]
    """at these times, one each; negative pushes [N]"""

    @model_validator(mode="after")
    def _match(self) -> Self:
        if len(self.times) != len(self.magnitudes):
            raise ValueError(f"{len(self.times)} times but {len(self.magnitudes)} magnitudes")
        if any(b <= a for a, b in zip(self.times, self.times[1:], strict=False)):
            raise ValueError("times must rise")
        return self

    @property
    def changes(self) -> tuple[float, ...]:
        """Corners after which it changes though it stood still before, or jumps from nothing."""
        moves = [a != b for a, b in zip((0.0, *self.magnitudes), self.magnitudes, strict=False)]  # up to each point
        jump = self.times[:1] if moves[0] else ()
        corners = zip(self.times, moves, (*moves[1:], False), strict=True)
        return (*jump, *(time for time, until, after in corners if after and not until))

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before the first point."""
        after = bisect.bisect_right(self.times, time)
        if after == 0:
            return np.zeros(3)
        if after == len(self.times):
            return self._along(self.magnitudes[-1])
        (t0, t1), (f0, f1) = self.times[after - 1 : after + 1], self.magnitudes[after - 1 : after + 1]
        return self._along(f0 + (f1 - f0) * (time - t0) / (t1 - t0))


class TrapezoidLoad(_Directed):
    """A load that is put on in a straight line, stays, and is taken off again; in no time at all it is a step."""

    kind: Literal["trapezoid"] = "trapezoid"
    magnitude: Force
    """once it is on [N]"""
    rise: NotNegative
    """time in which it is put on [s]; 0 for a step"""
    fall: NotNegative = 0.0
    """time in which it is taken off [s]; 0 for a step"""
    stay: NotNegative | None = None
    """time between [s]; for ever when left out"""
    start: NotNegative = 0.0
    """when it begins [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """When it is put on, and when it is taken off."""
        return (self.start,) if self.stay is None else (self.start, self._off)

    @property
    def _off(self) -> float:
        """When it begins to be taken off [s]."""
        return math.inf if self.stay is None else self.start + self.rise + self.stay

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        on = _part(time - self.start, self.rise)
        return self._along(self.magnitude * (on - _part(time - self._off, self.fall)))


class TapLoad(_Directed):
    """A tap with a finger: half a sine wave."""

    kind: Literal["tap"] = "tap"
    peak: Force
    """in the middle of the tap [N]"""
    duration: Time = 0.05
    """of the tap [s]"""
    start: NotNegative = 0.0
    """when it begins [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """When it begins."""
        return (self.start,)

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before and after."""
        part = min(max((time - self.start) / self.duration, 0.0), 1.0)
        return self._along(self.peak * max(math.sin(math.pi * part), 0.0))


def _part(time: float, length: float) -> float:
    """0 before, 1 after, a straight line for `length` [s] between; all of it from time 0 on when there is no length."""
    if time < 0.0:
        return 0.0
    return 1.0 if time >= length else time / length


class HungWeightLoad(_Directed):
    """A weight lowered onto a rubber band: it goes on swinging at the band's own frequency.

    The tip's own motion is small against the band's stretch and left out.
    """

    kind: Literal["hung_weight"] = "hung_weight"
    weight: Force
    """of what hangs there once it is at rest [N]"""
    lowering: Time = 2.0
    """time in which the hand lets go [s]"""
    frequency: Frequency = 2.0
    """of the weight on the band [Hz]"""
    damping: Annotated[float, Field(ge=1e-3, le=0.999)] = 0.05
    """part of the critical one"""
    start: NotNegative = 0.0
    """when the lowering begins [s]"""

    @property
    def changes(self) -> tuple[float, ...]:
        """When the lowering begins."""
        return (self.start,)

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before the lowering begins."""
        time -= self.start
        return self._along(self.weight * (self._taken_up(time) - self._taken_up(time - self.lowering)) / self.lowering)

    def _taken_up(self, time: float) -> float:
        """Integral of the oscillator's step response [s]."""
        if time <= 0.0:
            return 0.0
        rate = 2.0 * math.pi * self.frequency
        a, b = self.damping * rate, math.sqrt(1.0 - self.damping**2) * rate
        swing = (b - a * a / b) * math.sin(b * time) - 2.0 * a * math.cos(b * time)
        return time - (2.0 * a + math.exp(-a * time) * swing) / (rate * rate)


class AllAroundLoad(_AtTip):
    """A pull of one size whose direction goes over the whole sphere: from +z down to -z, and around meanwhile."""

    kind: Literal["all_around"] = "all_around"
    magnitude: Force
    """of the force, whatever its direction [N]"""
    period: Time
    """from one pole to the other [s]; then the same way back"""
    turns: Annotated[float, Field(ge=0.0, le=100.0)] = 2.0
    """around z from pole to pole"""
    ramp: Time = 5.0
    """time in which it sets in [s]"""

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        down, around = math.pi * time / self.period, 2.0 * math.pi * self.turns * time / self.period
        size = self.magnitude * _part(time, self.ramp)
        across = size * math.sin(down)
        return np.array([across * math.cos(around), across * math.sin(around), size * math.cos(down)])


class ContactLoad(_Directed):
    """Something leans on the shaft."""

    kind: Literal["contact"] = "contact"
    magnitude: Force
    """of its push [N]"""
    place: NotNegative
    """arc length from the plate [m]"""

    @property
    def contact(self) -> float:
        """Where on the shaft."""
        return self.place

    def force(self, time: float) -> Array:
        """(3,) [N] at `time` [s] since the motion's start; nothing before."""
        return self._along(self.magnitude if time >= 0.0 else 0.0)


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
    | ContactLoad,
    Field(discriminator="kind"),
]
