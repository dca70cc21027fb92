"""Model of the stages' command path: sample-and-hold with a transport delay.

The serial line to the stages carries one command per axis and command interval. A command waits half an interval on
average, arrives after the transport delay, and is then applied for one interval. Before a command takes effect, the
velocities sent earlier (after limits and quantisation) move the joints. The controller therefore plans for the joint
positions at which its command takes effect.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot.robot import Array


class ActuationState(NamedTuple):
    """State of the command path: the velocities already sent to the stages, and the joint motion that they cause."""

    sent: Array  #: (ticks, n) joint velocities sent to the stages, newest first [rad/s or m/s]
    ahead: Array  #: (n,) distance that the joints still move until a command sent now takes effect [rad or m]

    @property
    def velocity(self) -> Array:
        """(n,) present joint velocity [rad/s or m/s]."""
        return self.sent[-1]


@dataclass(frozen=True)
class Actuation:
    """Command interval and delay of the line to the stages."""

    period: float  #: time between two ticks of the controller [s]
    command_interval: float = 0.025  #: time between two commands to the same axis [s]
    transport_delay: float = 0.012  #: time from sending a command until the motor receives it [s]

    def __post_init__(self) -> None:
        for name in ("command_interval", "transport_delay"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise DescriptionError(f"actuation: {name} {value:g} s is outside 0 ... 1 s")

    @property
    def lead_time(self) -> float:
        """Average time from a command to its effect on the joint [s]."""
        return self.transport_delay + 0.5 * self.command_interval

    def start(self, joints: int) -> ActuationState:
        """Return the state of the command path for joints at rest."""
        ticks = round(self.transport_delay / self.period) + 1
        return ActuationState(np.zeros((ticks, joints)), np.zeros(joints))

    def update(self, last: ActuationState, sent: Array) -> ActuationState:
        """Return the state one tick later; `sent` (n,) are the joint velocities sent last [rad/s or m/s]."""
        new = ActuationState(np.empty_like(last.sent), np.empty_like(last.ahead))
        advance(last.sent, sent, self.period, 0.5 * self.command_interval, *new)
        return new


@compiled
def advance(history: Array, sent: Array, period: float, wait: float, moved: Array, ahead: Array) -> None:
    """Compute `Actuation.update` and write the new state to `moved` and `ahead`."""
    ticks, n = history.shape
    for j in range(n):
        moved[0, j] = sent[j]
        ahead[j] = wait * sent[j]
        for i in range(1, ticks):
            moved[i, j] = history[i - 1, j]
            ahead[j] += period * moved[i - 1, j]
