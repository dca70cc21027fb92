"""At rest before a motion: the filters settle, then sensors and tracker are averaged."""

import numpy as np

from core.robot.robot import Array

#: The first part lets the filters settle, the rest is averaged for the tare and for the start tip (60 frames).
SETTLE = 0.5  # [s]
AVERAGE = 1.5  # [s]


class Rest:
    """What was measured at rest so far."""

    def __init__(self, since: float) -> None:
        self.since = since  #: [s]
        self._wrenches: list[Array] = []
        self._tips: list[Array] = []

    def take(self, wrenches: Array, tip: Array | None) -> None:
        """One tick's wrenches (q, 6) and, if a frame has come, tip (3,)."""
        self._wrenches.append(wrenches)
        if tip is not None:
            self._tips.append(tip)

    @property
    def wrenches(self) -> Array:
        """Mean (q, 6) [N, N m]."""
        return np.mean(self._wrenches, axis=0)

    @property
    def tip(self) -> Array | None:
        """Mean (3,) [m]; None when no frame has come."""
        return np.mean(self._tips, axis=0) if self._tips else None
