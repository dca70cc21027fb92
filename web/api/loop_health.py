"""How punctual the loop was lately: what the histograms of its timing have gained since the last look."""

import time

import numpy as np

from station.control.ring import Ring

#: Over this time at least [s].
WINDOW = 1.0


class RecentTiming:
    """The loop's lateness and work over about the last second."""

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._then = time.monotonic()
        self._late, self._busy = ring.late.copy(), ring.busy.copy()
        self._last: dict[str, float | None] = {"late_us": None, "tick_us": None}

    def look(self) -> dict[str, float | None]:
        """99th percentiles [us] of `late_us` and `tick_us`; None before the first second is over."""
        now = time.monotonic()
        if now - self._then >= WINDOW:
            late, busy = self._ring.late.copy(), self._ring.busy.copy()
            self._last = {"late_us": _p99(late - self._late), "tick_us": _p99(busy - self._busy)}
            self._then, self._late, self._busy = now, late, busy
        return self._last


def _p99(gained: np.ndarray) -> float | None:
    total = int(gained.sum())
    # The statistics may have been cleared meanwhile: a negative gain says nothing.
    if total <= 0 or gained.min() < 0:
        return None
    return float(np.searchsorted(np.cumsum(gained), 0.99 * total) + 1)
