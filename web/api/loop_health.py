"""Recent timing of the control loop, computed from the increase of its timing histograms since the last reading."""

import time

import numpy as np

from station.control.ring import Ring

#: Shortest time over which the timing statistics are computed [s].
MIN_WINDOW_S = 1.0


class RecentTiming:
    """Lateness and work time of the control loop over about the last second."""

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._then = time.monotonic()
        self._late, self._busy = ring.late.copy(), ring.busy.copy()
        self._last: dict[str, float | None] = {"late_us": None, "tick_us": None}

    def read(self) -> dict[str, float | None]:
        """Return the 99th percentiles of lateness and work time [us]; None during the first second."""
        now = time.monotonic()
        if now - self._then >= MIN_WINDOW_S:
            late, busy = self._ring.late.copy(), self._ring.busy.copy()
            self._last = {"late_us": _p99(late - self._late), "tick_us": _p99(busy - self._busy)}
            self._then, self._late, self._busy = now, late, busy
        return self._last


def _p99(increase: np.ndarray) -> float | None:
    total = int(increase.sum())
    # The control process may have cleared its histograms: a negative increase is meaningless.
    if total <= 0 or increase.min() < 0:
        return None
    return float(np.searchsorted(np.cumsum(increase), 0.99 * total) + 1)
