"""The last samples of every force sensor, in counts, from which the wrenches at a common time are interpolated."""

import math

import numpy as np

from core.compiled import compiled, copy
from core.robot.robot import Array, Indices

#: Samples stored per sensor: those of several ticks at the highest record rate.
HISTORY_SAMPLES = 64


class SampleHistory:
    """A ring buffer of samples for each sensor."""

    def __init__(self, scale: Array) -> None:
        """`scale` (q, 6) is the force or moment per count [N, N m]."""
        self.rows = np.zeros((len(scale), HISTORY_SAMPLES, 7))  #: time [s] and six counts
        self._scale = scale
        self._ends = np.zeros((len(scale), 2), dtype=np.int64)  # index of the newest row, number of rows

    def ring(self, sensor: int) -> "SampleRing":
        """Return the ring buffer of one sensor."""
        return SampleRing(self.rows[sensor], self._ends[sensor])

    def at(self, time: float) -> Array:
        """Return wrenches (q, 6) at `time` [s], linearly interpolated; every sensor needs at least one sample."""
        return _at(self.rows, self._ends, time, self._scale)


class SampleRing:
    """The ring buffer of one sensor, with times that never decrease."""

    def __init__(self, rows: Array, ends: Indices) -> None:
        self.row = np.zeros(7)  #: the sample that `push` appends next: time [s] and six counts
        self.time = -math.inf  #: time of the newest sample; minus infinity: no sample [s]
        self.rows, self.ends = rows, ends

    def push(self) -> None:
        """Append `row`. Its time is raised to the newest one if a correction of the clock has made it earlier."""
        self.time = push(self.rows, self.ends, self.row, self.time)

    def clear(self) -> None:
        """Delete all samples."""
        self.ends[1], self.time = 0, -math.inf


@compiled
def push(rows: Array, ends: Indices, row: Array, time: float) -> float:
    """Compiled code of `SampleRing.push`: append `row` to the ring's arrays, and return the newest sample's time."""
    ends[0], ends[1] = (ends[0] + 1) % HISTORY_SAMPLES, min(ends[1] + 1, HISTORY_SAMPLES)
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
            after, before = before, (before - 1) % HISTORY_SAMPLES
        start, end = rows[i, before, 0], rows[i, after, 0]
        part = (time - start) / (end - start) if start < time < end else (1.0 if time >= end else 0.0)
        for k in range(6):
            a, b = rows[i, before, 1 + k], rows[i, after, 1 + k]
            wrenches[i, k] = scale[i, k] * (a + part * (b - a))
    return wrenches
