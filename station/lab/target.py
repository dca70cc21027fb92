"""The moving target of the virtual lab: it breathes along one line and beats like a heart along another line.

Rate and size of both oscillations drift, so that the station has to predict a target that is not exactly periodic.
"""

import math
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.lab.config import TargetConfig

#: Periods with which rate and size of the target's oscillations drift [s].
RATE_DRIFT_PERIOD_S, SIZE_DRIFT_PERIOD_S = 60.0, 45.0


class TargetWaves(NamedTuple):
    """One of the two oscillations of the target along a line: breathing or heartbeat."""

    amplitude: Array  #: (3,) displacement from the middle to the end of the line [m]
    rate: float  #: mean frequency of the oscillation [Hz]
    second: float  #: amplitude at twice the rate, as a fraction of the amplitude at the rate
    rate_drift: float  #: largest change of the rate in both directions, as a fraction
    size_drift: float  #: largest change of the amplitude in both directions, as a fraction
    phases: tuple[float, float, float]  #: phases at 0 s of the oscillation and of the drifts of rate and size [rad]

    def at(self, time: float) -> Array:
        """Return the displacement (3,) from the target's middle [m]."""
        own, of_rate, of_size = self.phases
        turn = 2.0 * math.pi
        # The phase of the oscillation is the integral of its drifting rate; `drift` is the part caused by the drift.
        drift = (
            self.rate_drift
            * RATE_DRIFT_PERIOD_S
            / turn
            * (math.cos(of_rate) - math.cos(turn * time / RATE_DRIFT_PERIOD_S + of_rate))
        )
        phase = turn * self.rate * (time + drift) + own
        size = 1.0 + self.size_drift * math.sin(turn * time / SIZE_DRIFT_PERIOD_S + of_size)
        return self.amplitude * (size * (math.sin(phase) + self.second * math.cos(2.0 * phase)))


class MovingTarget:
    """Position of the target as a function of time; its lines and phases are drawn once."""

    def __init__(self, config: TargetConfig, tip: Array, rng: np.random.Generator) -> None:
        """The target's middle is at the configured offset from `tip` (3,) [m]."""
        self._middle = tip + np.array(config.place)
        self._motions = tuple(
            TargetWaves(
                size * _direction(rng), rate, second, config.rate_drift, config.size_drift,
                tuple(rng.uniform(0.0, 2.0 * math.pi, 3).tolist()),
            )
            for size, rate, second in (
                (config.breathing, config.breathing_rate, config.breathing_second),
                (config.heartbeat, config.heartbeat_rate, 0.0),
            )
        )  # fmt: skip

    def at(self, time: float) -> Array:
        """Return the position of the target (3,) at `time` [s], world frame [m]."""
        breathing, heartbeat = self._motions
        return self._middle + breathing.at(time) + heartbeat.at(time)


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.standard_normal(3)
    return vector / float(np.linalg.norm(vector))
