"""Progress of homing: the present axis, its distance, and the remaining time."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.zaber.setup import StageSetup


class HomingStep(NamedTuple):
    """Motion of one axis to its home sensor."""

    joint: str
    unit: str
    way: float  #: distance [unit]
    exact: bool  #: the start position is known; otherwise `way` is the longest possible distance
    speed: float  #: [unit/s]


def homing_step(setup: StageSetup, count: float | None) -> HomingStep:
    """Return the motion of a stage from `count` [microsteps]; None: its position is unknown.

    Units home downwards. A rotation passes its sensor once per turn; one that starts below its zero turns back up.
    """
    turns, step, joint = setup.joint.motion == "rotation", setup.joint.microstep, setup.joint
    turn = 2.0 * math.pi
    if count is None:
        way = turn if turns else setup.maximum * step
    else:
        above = (count - setup.home_count) * step
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
    return HomingStep(joint.name, "rad" if turns else "m", abs(way), count is not None, setup.home_speed)


class Homing:
    """The motions of all axes, one after the other."""

    def __init__(self, steps: Sequence[HomingStep]) -> None:
        self._steps = tuple(steps)
        self._at, self._since = 0, 0.0

    def start(self, number: int, now: float) -> None:
        """Note that the step `number` starts at `now` [s]."""
        self._at, self._since = number, now

    def progress(self, now: float) -> Mapping[str, Any]:
        """Return the axis, its number and the number of axes, distance `gone` of `way` [unit], remaining time [s]."""
        step = self._steps[self._at]
        gone = min(step.way, (now - self._since) * step.speed)
        left = (step.way - gone) / step.speed + sum(each.way / each.speed for each in self._steps[self._at + 1 :])
        return {
            "joint": step.joint, "number": self._at + 1, "of": len(self._steps), "gone": gone, "way": step.way,
            "exact": step.exact, "unit": step.unit, "left_s": left,
        }  # fmt: skip
