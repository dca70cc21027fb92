"""How the memory of processes grows: resident size over time, and its slope."""

import os
from pathlib import Path

import numpy as np

_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def resident(pid: int) -> float | None:
    """Resident memory of a process [bytes]; None when it is gone, or the system does not tell."""
    try:
        return float(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return None


class Growth:
    """How the memory of one process grows."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._sizes: list[float] = []

    def add(self, time: float, size: float) -> None:
        """A size [bytes] at a time [s]."""
        self._times.append(time)
        self._sizes.append(size)

    @property
    def size(self) -> float:
        """The last [bytes]."""
        return self._sizes[-1] if self._sizes else 0.0

    @property
    def slope(self) -> float:
        """By a straight line through the second half: what a process needs it has by then [bytes/s]."""
        half = len(self._times) // 2
        if len(self._times) - half < 3:
            return 0.0
        return float(np.polyfit(self._times[half:], self._sizes[half:], 1)[0])
