"""Random walk of the tubes' precurvature, which changes slowly because real tubes creep and relax."""

import numpy as np

from core.robot.robot import Array

#: Time between two random draws; the walk is interpolated linearly between them [s].
KNOT_INTERVAL_S = 10.0


class RandomWalk:
    """One Brownian walk for each tube; its values do not depend on the times at which they are read."""

    def __init__(self, hourly: float, tubes: int, rng: np.random.Generator) -> None:
        """Create the walks; `hourly` is the standard deviation of the precurvature after an hour, as a fraction."""
        self._deviation = hourly * np.sqrt(KNOT_INTERVAL_S / 3600.0)
        self._rng = rng
        self._knots = [np.zeros(tubes)]

    def at(self, time: float) -> Array:
        """Return the change of each tube's precurvature (q,) at `time` >= 0 [s], as a fraction."""
        knots = max(time, 0.0) / KNOT_INTERVAL_S
        before = int(knots)
        while len(self._knots) < before + 2:
            last = self._knots[-1]
            self._knots.append(last + self._deviation * self._rng.standard_normal(last.size))
        part = knots - before
        return (1.0 - part) * self._knots[before] + part * self._knots[before + 1]
