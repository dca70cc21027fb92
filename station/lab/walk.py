"""A slow walk of what is said not to change: precurvature that creeps and relaxes, by a little, all the time."""

import numpy as np

from core.robot.robot import Array

#: Between two draws; straight lines between them [s].
KNOT = 10.0


class Walk:
    """One Brownian walk for each tube, the same whoever asks when."""

    def __init__(self, hourly: float, tubes: int, rng: np.random.Generator) -> None:
        """`hourly` is the standard deviation after an hour, as a fraction."""
        self._deviation = hourly * np.sqrt(KNOT / 3600.0)
        self._rng = rng
        self._knots = [np.zeros(tubes)]

    def at(self, time: float) -> Array:
        """How far each tube has gone (q,) at `time` >= 0 [s], as a fraction."""
        place = max(time, 0.0) / KNOT
        before = int(place)
        while len(self._knots) < before + 2:
            last = self._knots[-1]
            self._knots.append(last + self._deviation * self._rng.standard_normal(last.size))
        part = place - before
        return (1.0 - part) * self._knots[before] + part * self._knots[before + 1]
