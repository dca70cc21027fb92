"""Memory growth of processes: resident memory over time, and the slope of a fitted line."""

import os
from pathlib import Path

import numpy as np

_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def resident_bytes(pid: int) -> float | None:
    """Return the resident memory of a process [bytes]; None if it has ended or the system does not report it."""
    try:
        return float(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return None


class Growth:
    """Memory growth of one process."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._sizes: list[float] = []

    def add(self, time: float, size: float) -> None:
        """Add the resident memory `size` [bytes] that was measured at `time` [s]."""
        self._times.append(time)
        self._sizes.append(size)

    @property
    def size(self) -> float:
        """Latest resident memory [bytes]."""
        return self._sizes[-1] if self._sizes else 0.0

    @property
    def slope(self) -> float:
        """Slope of a line fitted to the second half of the sizes, which has no initial allocations [bytes/s]."""
        half = len(self._times) // 2
        if len(self._times) - half < 3:
            return 0.0
        return float(np.polyfit(self._times[half:], self._sizes[half:], 1)[0])
