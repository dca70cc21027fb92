"""The virtual lab's moving target: breathing and a heartbeat along lines of their own, drifting in rate and size."""

import math
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.lab.config import TargetConfig

#: In how long rate and size swing there and back [s].
RATE_SWING, SIZE_SWING = 60.0, 45.0


class Motion(NamedTuple):
    """One of the two: to and fro along a line."""

    way: Array  #: (3,) from its middle to its end [m]
    rate: float  #: on average [Hz]
    second: float  #: size of the wave of twice the rate, as a part of the first
    rate_drift: float  #: largest change of the rate, either way, as a part
    size_drift: float  #: of the size
    phases: tuple[float, float, float]  #: at 0 s: its own, of the rate's swing, of the size's [rad]

    def at(self, time: float) -> Array:
        """(3,) from the target's middle [m]."""
        own, of_rate, of_size = self.phases
        turn = 2.0 * math.pi
        # The integral of a rate that swings.
        swung = self.rate_drift * RATE_SWING / turn * (math.cos(of_rate) - math.cos(turn * time / RATE_SWING + of_rate))
        phase = turn * self.rate * (time + swung) + own
        size = 1.0 + self.size_drift * math.sin(turn * time / SIZE_SWING + of_size)
        return self.way * (size * (math.sin(phase) + self.second * math.cos(2.0 * phase)))


class MovingTarget:
    """Where the target is; a function of time alone, drawn once."""

    def __init__(self, config: TargetConfig, tip: Array, rng: np.random.Generator) -> None:
        """Its middle stands at the configured place from `tip` (3,) [m]."""
        self._middle = tip + np.array(config.place)
        self._motions = tuple(
            Motion(
                size * _direction(rng), rate, second, config.rate_drift, config.size_drift,
                tuple(rng.uniform(0.0, 2.0 * math.pi, 3).tolist()),
            )
            for size, rate, second in (
                (config.breathing, config.breathing_rate, config.breathing_second),
                (config.heartbeat, config.heartbeat_rate, 0.0),
            )
        )  # fmt: skip

    def at(self, time: float) -> Array:
        """(3,) at `time` [s], world frame [m]."""
        breathing, heartbeat = self._motions
        return self._middle + breathing.at(time) + heartbeat.at(time)


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.standard_normal(3)
    return vector / float(np.linalg.norm(vector))
