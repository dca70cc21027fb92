"""The last seconds of telemetry as the plots and the trace show them: means over a tenth of a second."""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.robot import Array
from station.loop import Phase
from station.ring import Ring
from station.telemetry import Channels

SPAN = 20.0  #: [s]
BIN = 0.1  #: [s]


class Point(NamedTuple):
    """Means over one bin; errors are NaN while no motion is on."""

    time: float  #: end of the bin [s]
    error: Array  #: desired minus measured tip (3,) [m]
    true_error: Array  #: desired minus true tip (3,) [m]; NaN where no truth is known
    force: Array  #: at the tip, from the base sensors (3,) [N]
    tip: Array  #: measured (3,) [m]


class History:
    """What has been read from the telemetry ring."""

    def __init__(self, channels: Channels) -> None:
        self.points: deque[Point] = deque(maxlen=round(SPAN / BIN))
        self.recent = np.empty((0, len(channels)))  #: rows of the last bin's length, newest last
        self.frame_time = -np.inf  #: when the newest tracker frame arrived [s]
        self.truth_known = False
        self._channels = channels
        self._ring: Ring | None = None
        self._next = 0
        self._rows: list[Array] = []

    def read(self, ring: Ring, phase: Phase) -> None:
        """Take what has been written since the last call; a new ring begins a new history."""
        if ring is not self._ring:
            self._ring, self._next, self._rows = ring, ring.written, []
            self.points.clear()
            self.recent, self.frame_time = self.recent[:0], -np.inf
        rows, self._next, _ = ring.read(self._next)
        if not len(rows):
            return
        of = self._channels.of
        self.truth_known = bool(of(rows[-1], "truth_known")[0])
        arrived = of(rows, "tip_new")[:, 0] > 0.0
        if arrived.any():
            self.frame_time = float(of(rows, "time")[arrived][-1, 0])
        both = np.concatenate((self.recent, rows))
        times = of(both, "time")[:, 0]
        self.recent = both[times > times[-1] - BIN]
        number = np.floor(of(rows, "time")[:, 0] / BIN)
        for part in np.split(rows, np.flatnonzero(np.diff(number)) + 1):
            if self._rows and np.floor(of(self._rows[-1][-1], "time")[0] / BIN) != np.floor(of(part[0], "time")[0] / BIN):
                self._close_bin(phase)
            self._rows.append(part)

    @property
    def now(self) -> float:
        """Time of the newest row [s]; 0 before the first."""
        return float(self._channels.of(self.recent[-1], "time")[0]) if len(self.recent) else 0.0

    def mean(self, group: str) -> Array:
        """Mean of a group over the last bin's length; the sensors' noise would make a picture tremble."""
        return self._channels.of(self.recent, group).mean(axis=0)

    def _close_bin(self, phase: Phase) -> None:
        rows, self._rows = np.concatenate(self._rows), []
        mean = {name: self._channels.of(rows, name).mean(axis=0) for name in ("tip_measured", "tip_true", "force")}
        desired = self._channels.of(rows, "tip_desired").mean(axis=0)
        nothing = np.full(3, np.nan)
        moving = phase is Phase.MOVING
        self.points.append(
            Point(
                float(self._channels.of(rows[-1], "time")[0]),
                desired - mean["tip_measured"] if moving else nothing,
                desired - mean["tip_true"] if moving and self.truth_known else nothing,
                mean["force"],
                mean["tip_measured"],
            )
        )
