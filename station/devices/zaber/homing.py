"""How far homing has come: which axis is at it, how far it has gone, and how long all of it takes yet."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.zaber.setup import StageSetup


class Leg(NamedTuple):
    """One axis's way to its home sensor."""

    joint: str
    unit: str
    way: float  #: [unit]
    exact: bool  #: where it begins is known; else `way` is the longest that it can be
    speed: float  #: [unit/s]


def leg(setup: StageSetup, count: float | None) -> Leg:
    """The way of a stage that stands at `count` [microsteps]; None: nobody knows where.

    Units home downwards. A rotation meets its sensor once a turn; one that begins below its zero turns back up.
    """
    turns, step, joint = setup.joint.motion == "rotation", setup.joint.microstep, setup.joint
    turn = 2.0 * math.pi
    if count is None:
        way = turn if turns else setup.maximum * step
    else:
        above = (count - setup.home_count) * step
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
    return Leg(joint.name, "rad" if turns else "m", abs(way), count is not None, setup.home_speed)


class Homing:
    """The ways of all axes, one after the other."""

    def __init__(self, legs: Sequence[Leg]) -> None:
        self._legs = tuple(legs)
        self._at, self._since = 0, 0.0

    def begin(self, number: int, now: float) -> None:
        """Leg `number` begins [s]."""
        self._at, self._since = number, now

    def told(self, now: float) -> Mapping[str, Any]:
        """Axis, its number among how many, how far of which way it has `gone` [unit], and how long is left [s]."""
        on = self._legs[self._at]
        gone = min(on.way, (now - self._since) * on.speed)
        left = (on.way - gone) / on.speed + sum(each.way / each.speed for each in self._legs[self._at + 1 :])
        return {
            "joint": on.joint, "number": self._at + 1, "of": len(self._legs), "gone": gone, "way": on.way,
            "exact": on.exact, "unit": on.unit, "left_s": left,
        }  # fmt: skip
