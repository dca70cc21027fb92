"""Detection of whether the tracker measures a moving target now.

The values of the target's telemetry channels do not show a loss of the target, because they keep their last values.
"""

import numpy as np

from core.robot.robot import Array
from station.control.follow import TARGET_LOST_S
from station.control.telemetry import Channels


class TargetVisibility:
    """Detector of a visible target; it must receive all rows of telemetry."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._seen = -np.inf  # time of the last measurement of the target, by the time of the rows [s]

    def update(self, rows: Array) -> bool:
        """Return whether the target's last measurement is younger than `TARGET_LOST_S`, given the new `rows`."""
        times = self._channels.of(rows, "time")[:, 0]
        new = self._channels.of(rows, "target_new")[:, 0] > 0.0
        now = float(times[-1])
        if new.any():
            self._seen = float(times[new][-1])
        elif self._seen > now:
            self._seen = -np.inf  # the control process has restarted, because the time of the rows decreased
        return now - self._seen <= TARGET_LOST_S
