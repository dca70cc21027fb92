"""Measurement at rest before a motion: the filters settle, then sensor and tracker readings are averaged."""

import numpy as np

from core.robot.robot import Array

#: Time at rest in which the filters settle [s].
SETTLE_S = 0.5
#: Time after the settling in which readings are averaged for the tare and the start tip [s]; the tracker sends 60
#: frames in this time.
AVERAGE_S = 1.5


class SettlePhase:
    """Readings of the force sensors and of the tip while the robot rests, and their means."""

    def __init__(self, since: float) -> None:
        self.since = since  #: start of the measurement [s]
        self._wrenches: list[Array] = []
        self._tips: list[Array] = []

    def take(self, wrenches: Array, tip: Array | None) -> None:
        """Add the wrenches of one tick (one row of 6 for each sensor) and, after a new tracker frame, its tip (3,)."""
        self._wrenches.append(wrenches)
        if tip is not None:
            self._tips.append(tip)

    @property
    def wrenches(self) -> Array:
        """Mean wrench of each sensor, one row of 6 [N, N m]."""
        return np.mean(self._wrenches, axis=0)

    @property
    def tip(self) -> Array | None:
        """Mean position of the tip (3,) [m]; None without a tracker frame."""
        return np.mean(self._tips, axis=0) if self._tips else None
