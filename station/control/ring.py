"""Telemetry in shared memory: one writer that never waits, readers that know what they missed.

The segment holds a few counters, two histograms of the loop's timing and a ring of rows. The
writer fills a slot and then counts it; a reader copies slots and then looks at the count again:
whatever the writer may have touched meanwhile is thrown away and reported as missed.
"""

import contextlib
import os
import secrets
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.control.leading import Wish
from core.robot.robot import Array
from station.control.led import Asked
from station.devices.interfaces import Truth

PREFIX = "psm_ctr_"  #: of a segment's name, before the number of the process that made it
SEGMENTS = Path("/dev/shm")  # noqa: S108 - where Linux has them

ROWS = 4096  #: slots, about 8 s at 500 Hz
BINS = 5001  #: 1 us each; the last holds everything from 5 ms on

#: Places of the counters; the last one is an installed driver that is being called, counted from 1; 0: none.
WRITTEN, MISSED, SCHEDULER, STATE, PHASE, RUN, STUCK, CALLED = range(8)
COUNTERS = 8
#: Places of the numbers; a heartbeat is when its process has shown last that it lives, by the station's clock [s].
LATE_MAX, TICK_MAX, PROGRESS, HEARTBEAT, STATION_HEARTBEAT, LAB_HEARTBEAT, RECORDER_HEARTBEAT = range(7)
NUMBERS = 8
#: A count that is odd while they are being written, then tip, force, whether there is a target, and where it is.
TRUTH = 14
#: Such a count, run, whether it is a place, place, velocity, when it came, how long it goes on, whether there is a
#: direction, and it.
WISH = 15


class Timing(NamedTuple):
    """How punctual the loop is, since it began."""

    ticks: int
    missed: int  #: whole periods skipped
    late_us: dict[str, float]  #: from the deadline to the start of the tick: p50, p99, p99_9, max
    tick_us: dict[str, float]  #: length of a tick's work: the same
    scheduler: str


class Ring:
    """The segment, written by the control process and read by others."""

    def __init__(self, width: int, name: str | None = None) -> None:
        """Create a segment for rows of `width` numbers, or attach to the one called `name`."""
        size = 8 * (COUNTERS + NUMBERS + TRUTH + WISH + 2 * BINS + ROWS * width)
        self._memory = SharedMemory(name or _new_name(), create=name is None, size=size)
        self.name: str = self._memory.name
        buffer: Any = self._memory.buf
        offset = 0

        def view(count: int, kind: type[np.generic]) -> NDArray[Any]:
            nonlocal offset
            array: NDArray[Any] = np.frombuffer(buffer, kind, count, offset)
            offset += 8 * count
            return array

        self.counters: NDArray[np.int64] = view(COUNTERS, np.int64)
        self.numbers: Array = view(NUMBERS, np.float64)
        self._truth: Array = view(TRUTH, np.float64)
        self._wish: Array = view(WISH, np.float64)
        self.late: NDArray[np.int64] = view(BINS, np.int64)
        self.busy: NDArray[np.int64] = view(BINS, np.int64)
        self._rows: Array = view(ROWS * width, np.float64).reshape(ROWS, width)
        self._told: Truth | None = None
        self._asked: Asked | None = None

    def write(self, row: Array) -> None:
        """Add a row; only the one writer may."""
        written = int(self.counters[WRITTEN])
        self._rows[written % ROWS] = row
        self.counters[WRITTEN] = written + 1

    def publish_ground_truth(self, truth: Truth, stuck: bool = False) -> None:
        """What the virtual lab knows, and whether its robot cannot follow its stages; only the lab may."""
        cells = self._truth
        self.counters[STUCK] = stuck
        cells[0] += 1.0
        cells[1:4], cells[4:7], cells[7] = truth.tip, truth.force, truth.target is not None
        cells[11:14] = 0.0 if truth.direction is None else truth.direction
        if truth.target is not None:
            cells[8:11] = truth.target
        cells[0] += 1.0

    def truth(self) -> Truth | None:
        """What the virtual lab told last; None without one."""
        before = self._truth[0]
        values = self._truth.copy()
        if before and not before % 2.0 and values[0] == before and self._truth[0] == before:
            self._told = Truth(values[1:4], values[4:7], values[8:11] if values[7] else None, values[11:14])
        return self._told  # what it told before, while it is just telling: a loop does not wait for it

    def ask(self, asked: Asked) -> None:
        """Ask something of a tip that is led; only the station process may."""
        cells, wish = self._wish, asked.wish
        cells[0] += 1.0
        cells[1], cells[2] = asked.run, -1.0 if wish is None else float(wish.place is not None)
        if wish is not None:
            cells[3:6], cells[6:9] = 0.0 if wish.place is None else wish.place, wish.velocity
            cells[9], cells[10], cells[11] = wish.asked, wish.goes_on, wish.direction is not None
            cells[12:15] = 0.0 if wish.direction is None else wish.direction
        cells[0] += 1.0

    def asked(self, run: int) -> Asked | None:
        """What was asked of the led tip of that run last, by the station's clock; None before anything was."""
        before = self._wish[0]
        if not before or self._wish[1] != run:
            return None
        values = self._wish.copy()
        if not before % 2.0 and values[0] == before and self._wish[0] == before:
            wish = None
            if values[2] >= 0.0:
                place = values[3:6] if values[2] else None
                direction = values[12:15] if values[11] else None
                wish = Wish(place, values[6:9], float(values[9]), float(values[10]), direction)
            self._asked = Asked(run, wish)
        # What was asked before, while something is just being asked.
        return self._asked if self._asked is not None and self._asked.run == run else None

    def time_late(self, late: float, skipped: int) -> None:
        """Count how late a tick begins [s] and how many whole periods that skips."""
        late_us = 1e6 * late
        self.late[min(max(int(late_us), 0), BINS - 1)] += 1
        self.counters[MISSED] += skipped
        if late_us > self.numbers[LATE_MAX]:
            self.numbers[LATE_MAX] = late_us

    def time_work(self, busy: float) -> None:
        """Count the length of a tick's work [s]."""
        busy_us = 1e6 * busy
        self.busy[min(max(int(busy_us), 0), BINS - 1)] += 1
        if busy_us > self.numbers[TICK_MAX]:
            self.numbers[TICK_MAX] = busy_us

    @property
    def written(self) -> int:
        """Rows written so far."""
        return int(self.counters[WRITTEN])

    def read(self, since: int) -> tuple[Array, int, int]:
        """Rows from number `since` on, the number to continue from, and how many were missed."""
        written = self.written
        # The slot being written next must not be trusted.
        first = max(since, written - ROWS + 1, 0)
        rows = self._rows[np.arange(first, written) % ROWS]
        safe = max(first, self.written - ROWS + 1)
        return rows[safe - first :], written, safe - since if safe > since else 0

    def latest(self) -> Array | None:
        """The newest row, if any."""
        rows, _, _ = self.read(max(self.written - 1, 0))
        return rows[-1] if len(rows) else None

    def timing(self) -> Timing:
        """Percentiles of lateness and work."""
        return Timing(
            int(self.late.sum()),
            int(self.counters[MISSED]),
            _percentiles(self.late, float(self.numbers[LATE_MAX])),
            _percentiles(self.busy, float(self.numbers[TICK_MAX])),
            "SCHED_FIFO" if self.counters[SCHEDULER] else "normal priority",
        )

    def later_than(self, late: float) -> int:
        """How many ticks have begun so late [s, below 5 ms] or later."""
        return int(self.late[int(1e6 * late) :].sum())

    def clear_timing(self) -> None:
        """Start the statistics anew."""
        self.late[:], self.busy[:] = 0, 0
        self.counters[MISSED] = 0
        self.numbers[LATE_MAX] = self.numbers[TICK_MAX] = 0.0

    def close(self, *, remove: bool) -> None:
        """Let go of the segment; the one who created it also removes it."""
        del self.counters, self.numbers, self._truth, self._wish, self.late, self.busy, self._rows
        self._memory.close()
        if remove:
            try:
                self._memory.unlink()
            except FileNotFoundError:
                return  # somebody else tidied up after a crash


def _new_name() -> str:
    """Says whose it is, for `clear_left_behind`."""
    return f"{PREFIX}{os.getpid()}_{secrets.token_hex(4)}"


def clear_left_behind() -> None:
    """Remove the segments of stations that were killed, where segments are files (Linux); those of others stay."""
    for path in SEGMENTS.glob(f"{PREFIX}*_*"):
        process = path.name.removeprefix(PREFIX).partition("_")[0]
        with contextlib.suppress(OSError, ValueError):  # another's, another station has just removed it, or no number
            if path.stat().st_uid == os.getuid() and not _runs(int(process)):
                path.unlink()


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass  # another user's
    return True


def _percentiles(histogram: NDArray[np.int64], largest: float) -> dict[str, float]:
    total = int(histogram.sum())
    result: dict[str, float] = {}
    for name, part in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
        place = int(np.searchsorted(np.cumsum(histogram), part * total)) if total else 0
        # A bin's upper edge, never more than what was seen.
        result[name] = min(float(place + 1), largest) if total else 0.0
    result["max"] = round(largest, 1)
    return result
