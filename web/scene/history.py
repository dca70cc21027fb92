"""Recent telemetry for the scene, averaged over a tenth of a second."""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.control.ring import Ring
from station.control.telemetry import Channels
from web.scene.target_visibility import TargetVisibility

TRACE_SPAN_S = 20.0  #: duration of the drawn trace of the tip [s]
TRACE_BIN_S = 0.1  #: time over which one point of the trace is averaged [s]


class TracePoint(NamedTuple):
    """Point of the trace: mean of the telemetry over one interval of `TRACE_BIN_S`."""

    time: float  #: centre of the interval [s]
    tip: Array  #: mean of the measured tip (3,) [m]


class TipTrace:
    """Recent telemetry that the scene reads from the ring: the trace of the tip, and the newest rows."""

    def __init__(self, channels: Channels) -> None:
        self.points: deque[TracePoint] = deque(maxlen=round(TRACE_SPAN_S / TRACE_BIN_S))
        self.recent = np.empty((0, len(channels)))  #: telemetry rows of the last `TRACE_BIN_S`, newest last
        self.measured = -np.inf  #: time of the newest row that contains a new measurement of the tip [s]
        self.target_visible = False  #: whether the tracker measures a moving target now
        self._channels = channels
        self._target = TargetVisibility(channels)
        self._next = 0
        self._open = self.recent

    def read(self, ring: Ring) -> None:
        """Read the telemetry rows that were written since the last call.

        If the time of the rows decreases, the control process has restarted, and a new trace is started.
        """
        rows, self._next, _ = ring.read(self._next)
        if len(rows):
            self.take(rows)

    def take(self, rows: Array) -> None:
        """Add telemetry `rows` (n, channels)."""
        of = self._channels.of
        self.target_visible = self._target.update(rows)
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
        self.recent = self.recent[of(self.recent, "time")[:, 0] > times[-1] - TRACE_BIN_S]
        self._open = np.concatenate((self._open, rows))
        numbers = np.floor(of(self._open, "time")[:, 0] / TRACE_BIN_S + 1e-6)
        *closed, self._open = np.split(self._open, np.flatnonzero(np.diff(numbers)) + 1)
        self.points.extend(
            TracePoint(float(of(part, "time")[0, 0]) + 0.5 * TRACE_BIN_S, of(part, "tip_measured").mean(axis=0))
            for part in closed
            if of(part, "tip_new").any()  # an interval without a measurement of the tip has no point
        )

    @property
    def now(self) -> float:
        """Time of the newest telemetry row [s]; 0 before the first."""
        return float(self._channels.of(self.recent[-1], "time")[0]) if len(self.recent) else 0.0

    @property
    def trace(self) -> Array:
        """Measured tip in the last `TRACE_SPAN_S`, oldest first (k, 3) [m]."""
        tips = [point.tip for point in self.points if point.time > self.now - TRACE_SPAN_S]
        return np.array(tips).reshape(-1, 3)

    def group(self, name: str) -> Array:
        """Return the values of a channel group over the last `TRACE_BIN_S` (n, ...)."""
        return self._channels.of(self.recent, name)

    def mean(self, group: str) -> Array:
        """Return the mean of a channel group over the last `TRACE_BIN_S`, which reduces noise in the picture."""
        return self.group(group).mean(axis=0)
