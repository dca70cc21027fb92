"""Whether a target that moves is seen now: its channels go on when it is lost, and are zero where there is none."""

import numpy as np

from core.robot.robot import Array
from station.control.follow import LOST
from station.control.telemetry import Channels


class TargetSeen:
    """Told all rows of telemetry as they come."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._seen = -np.inf  # [s], by the rows' own time

    def look(self, rows: Array) -> bool:
        """With the newest `rows` (n, channels), n > 0: whether it was seen in the last `LOST` before their end."""
        times = self._channels.of(rows, "time")[:, 0]
        new = self._channels.of(rows, "target_new")[:, 0] > 0.0
        now = float(times[-1])
        if new.any():
            self._seen = float(times[new][-1])
        elif self._seen > now:
            self._seen = -np.inf  # the control process has begun anew
        return now - self._seen <= LOST
