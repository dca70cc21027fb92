"""Progress of homing: the axis that moves, the distance of its motion, and the remaining time."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.zaber.setup import StageSetup


class HomingStep(NamedTuple):
    """Motion of one axis to its home sensor."""

    joint: str
    unit: str
    way: float  #: distance of the motion [unit]
    exact: bool  #: whether the start position is known; if not, `way` is the longest possible distance
    speed: float  #: speed of the motion [unit/s]


def homing_step(setup: StageSetup, count: float | None) -> HomingStep:
    """Return the homing motion of a stage from `count` [microsteps]; None: the position is unknown.

    Units home towards lower counts. A rotation stage passes its sensor once per turn; a rotation stage that starts
    below its zero turns back up by one turn after it has found the sensor.
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
    """Progress of the homing motions of all axes, which home one after the other."""

    def __init__(self, steps: Sequence[HomingStep]) -> None:
        self._steps = tuple(steps)
        self._at, self._since = 0, 0.0

    def start(self, number: int, now: float) -> None:
        """Record that the homing motion with the index `number` starts at `now` [s]."""
        self._at, self._since = number, now

    def progress(self, now: float) -> Mapping[str, Any]:
        """Return the moving axis, its number `of` all, distance `gone` of `way` [unit], and remaining time [s]."""
        step = self._steps[self._at]
        gone = min(step.way, (now - self._since) * step.speed)
        left = (step.way - gone) / step.speed + sum(each.way / each.speed for each in self._steps[self._at + 1 :])
        return {
            "joint": step.joint, "number": self._at + 1, "of": len(self._steps), "gone": gone, "way": step.way,
            "exact": step.exact, "unit": step.unit, "left_s": left,
        }  # fmt: skip
