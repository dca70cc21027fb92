"""The last samples of every force sensor, to be read at one time: in counts, all of it in one array."""

import math

import numpy as np

from core.compiled import compiled, copy
from core.robot.robot import Array, Indices

#: Kept of each sensor: several ticks at the fastest rate.
DEPTH = 64


class History:
    """A ring of samples for each sensor."""

    def __init__(self, scale: Array) -> None:
        """`scale` (q, 6) is what a count is worth [N, N m]."""
        self.rows = np.zeros((len(scale), DEPTH, 7))  #: time [s] and six counts
        self._scale = scale
        self._ends = np.zeros((len(scale), 2), dtype=np.int64)  # the newest row, how many there are

    def ring(self, sensor: int) -> "Ring":
        """The ring of one sensor."""
        return Ring(self.rows[sensor], self._ends[sensor])

    def at(self, time: float) -> Array:
        """Wrenches (q, 6) at `time` [s], each on the line between the samples next to it; every ring has one."""
        return _at(self.rows, self._ends, time, self._scale)


class Ring:
    """The samples of one sensor, whose times never run back."""

    def __init__(self, rows: Array, ends: Indices) -> None:
        self.row = np.zeros(7)  #: for the next sample: time [s] and six counts
        self.time = -math.inf  #: of the newest sample; infinite: there is none [s]
        self.rows, self.ends = rows, ends

    def push(self) -> None:
        """Take what has been put into `row`; a less delayed record may have set the clock back."""
        self.time = push(self.rows, self.ends, self.row, self.time)

    def clear(self) -> None:
        """Forget them."""
        self.ends[1], self.time = 0, -math.inf


@compiled
def push(rows: Array, ends: Indices, row: Array, time: float) -> float:
    """`Ring.push`: the time of the newest sample."""
    ends[0], ends[1] = (ends[0] + 1) % DEPTH, min(ends[1] + 1, DEPTH)
    time = max(time, row[0])
    copy(row, rows[ends[0]])
    rows[ends[0], 0] = time
    return time


@compiled
def _at(rows: Array, ends: Indices, time: float, scale: Array) -> Array:
    wrenches = np.empty(scale.shape)
    for i in range(scale.shape[0]):
        after = before = ends[i, 0]
        for _ in range(ends[i, 1] - 1):
            if rows[i, before, 0] <= time:
                break
            after, before = before, (before - 1) % DEPTH
        begin, end = rows[i, before, 0], rows[i, after, 0]
        part = (time - begin) / (end - begin) if begin < time < end else (1.0 if time >= end else 0.0)
        for k in range(6):
            a, b = rows[i, before, 1 + k], rows[i, after, 1 + k]
            wrenches[i, k] = scale[i, k] * (a + part * (b - a))
    return wrenches
