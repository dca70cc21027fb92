"""The stages as they are: a velocity goes out when the line is free, works later and is held.

A command of this tick waits half a hold for its turn on average, travels, and then stands for a
hold. What has gone out already (after limits and quantisation) will move the joints meanwhile; so the
controller plans for the place where the joints will be when its command takes effect.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.robot import Array


class Motion(NamedTuple):
    """How the joints move, by what was sent to them."""

    sent: Array  #: (ticks, n) velocities that went out, newest first [rad/s or m/s]
    ahead: Array  #: (n,) way they will have gone when a command of now takes effect [rad or m]

    @property
    def velocity(self) -> Array:
        """(n,) what they do now [rad/s or m/s]."""
        return self.sent[-1]


@dataclass(frozen=True)
class Actuation:
    """Hold and delay of the line to the stages."""

    period: float  #: between ticks [s]
    hold: float = 0.025  #: between two commands to the same axis [s]
    transport: float = 0.012  #: from the command to the motor [s]

    def __post_init__(self) -> None:
        for name, value in (("hold", self.hold), ("transport", self.transport)):
            if not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise DescriptionError(f"actuation: {name} {value:g} s is outside 0 ... 1 s")

    @property
    def lead(self) -> float:
        """Time from a command to its effect, on average [s]."""
        return self.transport + 0.5 * self.hold

    def start(self, joints: int) -> Motion:
        """At rest."""
        ticks = round(self.transport / self.period) + 1
        return Motion(np.zeros((ticks, joints)), np.zeros(joints))

    def update(self, last: Motion, sent: Array) -> Motion:
        """One tick on, `sent` (n,) being the velocities that the line carried last [rad/s or m/s]."""
        new = Motion(np.empty_like(last.sent), np.empty_like(last.ahead))
        advance(last.sent, sent, self.period, 0.5 * self.hold, *new)
        return new


@compiled
def advance(history: Array, sent: Array, period: float, wait: float, moved: Array, ahead: Array) -> None:
    """`Actuation.update`, into the last two."""
    ticks, n = history.shape
    for j in range(n):
        moved[0, j] = sent[j]
        ahead[j] = wait * sent[j]
        for i in range(1, ticks):
            moved[i, j] = history[i - 1, j]
            ahead[j] += period * moved[i - 1, j]
