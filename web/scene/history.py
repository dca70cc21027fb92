"""The last seconds of telemetry as the scene shows them: means over a tenth of a second."""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.control.ring import Ring
from station.control.telemetry import Channels
from web.scene.target_seen import TargetSeen

SPAN = 20.0  #: [s]
BIN = 0.1  #: [s]


class Point(NamedTuple):
    """Means over one bin."""

    time: float  #: middle of the bin [s]
    tip: Array  #: measured (3,) [m]


class History:
    """What has been read from the telemetry ring."""

    def __init__(self, channels: Channels) -> None:
        self.points: deque[Point] = deque(maxlen=round(SPAN / BIN))
        self.recent = np.empty((0, len(channels)))  #: rows of the last bin's length, newest last
        self.measured = -np.inf  #: time of the newest row with a measurement of its own of the tip [s]
        self.target_seen = False  #: there is a target, and the tracker sees it now
        self._channels = channels
        self._target = TargetSeen(channels)
        self._next = 0
        self._open = self.recent

    def read(self, ring: Ring) -> None:
        """Take what has been written since the last call.

        Time that runs backward, after a restart of the control process, begins a new history.
        """
        rows, self._next, _ = ring.read(self._next)
        if len(rows):
            self.take(rows)

    def take(self, rows: Array) -> None:
        """Add telemetry `rows` (n, channels)."""
        of = self._channels.of
        self.target_seen = self._target.look(rows)
        times = of(rows, "time")[:, 0]
        backward = np.flatnonzero(np.diff(times, prepend=self.now) < 0.0)
        if len(backward):
            rows, times = rows[backward[-1] :], times[backward[-1] :]
            self.points.clear()
            self.measured = -np.inf
            self.recent, self._open = self.recent[:0], self.recent[:0]
        new = of(rows, "tip_new")[:, 0] > 0.0
        if new.any():
            self.measured = float(times[new][-1])
        self.recent = np.concatenate((self.recent, rows))
        self.recent = self.recent[of(self.recent, "time")[:, 0] > times[-1] - BIN]
        self._open = np.concatenate((self._open, rows))
        numbers = np.floor(of(self._open, "time")[:, 0] / BIN + 1e-6)
        *closed, self._open = np.split(self._open, np.flatnonzero(np.diff(numbers)) + 1)
        self.points.extend(
            Point(float(of(part, "time")[0, 0]) + 0.5 * BIN, of(part, "tip_measured").mean(axis=0))
            for part in closed
            if of(part, "tip_new").any()  # what stands still while nothing is measured is no way of the tip
        )

    @property
    def now(self) -> float:
        """Time of the newest row [s]; 0 before the first."""
        return float(self._channels.of(self.recent[-1], "time")[0]) if len(self.recent) else 0.0

    @property
    def trace(self) -> Array:
        """Where the measured tip was in the last `SPAN`, oldest first (k, 3) [m]."""
        tips = [point.tip for point in self.points if point.time > self.now - SPAN]
        return np.array(tips).reshape(-1, 3)

    def group(self, name: str) -> Array:
        """A group over the last bin's length (n, ...)."""
        return self._channels.of(self.recent, name)

    def mean(self, group: str) -> Array:
        """Mean of a group over the last bin's length; the sensors' noise would make a picture tremble."""
        return self.group(group).mean(axis=0)
