"""Telemetry in shared memory: one writer that never waits; readers detect the rows that they missed.

The shared memory segment has a few counters, two histograms of the loop's timing and a ring of rows. The writer fills a
slot of the ring and then increments the count of rows. A reader copies slots and then reads the count again: slots that
the writer may have changed meanwhile are discarded and reported as missed.
"""

import contextlib
import os
import re
import secrets
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.control.setpoint_request import SetpointRequest
from core.robot.robot import Array
from station.control.realtime import exists
from station.control.task import StreamRequest
from station.devices.interfaces import GroundTruth

SEGMENT_PREFIX = "psm_ctr_"  #: start of a segment's name; the pid of the process that created it follows
SEGMENT_FOLDER = Path("/dev/shm")  # noqa: S108 - folder in which Linux shows segments as files
_SEGMENT_NAME = re.compile(rf"{SEGMENT_PREFIX}(\d{{1,7}})_[0-9a-f]{{8}}")  # Linux has no pid of more than 7 digits

RING_ROWS = 4096  #: number of rows in the ring: about 8 s at 500 Hz
HISTOGRAM_BINS = 5001  #: number of bins of 1 us in a histogram; the last bin counts all values from 5 ms on

#: Number of ranks of processes that may stop the stages (`guard.py`).
RANKS = 6
#: Indices of the counters. DRIVER_IN_CALL is the number of the custom driver or loop that is being called, from 1; 0 if
#: there is none. GENERATION is the number of requested STOPs and resets; only the station process writes it. DRIVEN is
#: 1 after a control process of this station has opened the stages. PREPARED_LATE is the number of functions that were
#: compiled or loaded while the control loop was running. DRIVER is the process ID of the control process that has
#: opened the stages, until they are stopped after its end; 0 if there is none. From WATCHERS on follow the process
#: IDs of the processes that stop the stages in its place, by their rank.
WRITTEN, MISSED, SCHEDULER, STATE, PHASE, RUN, STUCK, DRIVER_IN_CALL, GENERATION, DRIVEN, PREPARED_LATE = range(11)
DRIVER, WATCHERS = 11, 12
COUNTERS = WATCHERS + RANKS
#: Indices of the floating-point numbers. A heartbeat is the time at which a process last reported that it is alive, by
#: the station's clock [s]. SHAPE_PORT is the UDP port at which the virtual lab gives the true shape to simulated
#: cameras, and BALL_PORT the one at which the driver `stereo` receives the pixels of the ball; 0 if there is no port.
LATE_MAX, TICK_MAX, PROGRESS, HEARTBEAT, STATION_HEARTBEAT, LAB_HEARTBEAT, RECORDER_HEARTBEAT = range(7)
SHAPE_PORT, BALL_PORT = 7, 8
NUMBERS = 9
#: Number of cells of the lab's ground truth. The cells are: write count (odd during a write), tip, force, whether there
#: is a target, position of the target, direction of the tip.
TRUTH = 14
#: Largest size of the description of the stages for the processes that may have to stop them [bytes].
BRIEFING_BYTES = 65536
#: Number of cells of a setpoint request. The cells are: write count (odd during a write), run, whether there is a
#: position, position, velocity, time, extrapolation, whether there is a direction, direction.
SETPOINT_REQUEST = 15


class Timing(NamedTuple):
    """Timing statistics of the control loop since its start."""

    ticks: int  #: number of ticks
    missed: int  #: number of whole periods skipped
    late_us: dict[str, float]  #: time from the deadline to the start of a tick [us]: p50, p99, p99_9, max
    tick_us: dict[str, float]  #: duration of a tick's work [us]: p50, p99, p99_9, max
    scheduler: str  #: "SCHED_FIFO" or "normal priority"


class Ring:
    """Shared memory segment with telemetry, which the control process writes and other processes read."""

    def __init__(self, width: int, name: str | None = None) -> None:
        """Create a shared memory segment for rows of `width` numbers, or attach to the segment called `name`."""
        cells = COUNTERS + NUMBERS + TRUTH + SETPOINT_REQUEST + 2 * HISTOGRAM_BINS + RING_ROWS * width
        size = 8 * cells + BRIEFING_BYTES
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
        self._request_cells: Array = view(SETPOINT_REQUEST, np.float64)
        self.late: NDArray[np.int64] = view(HISTOGRAM_BINS, np.int64)
        self.busy: NDArray[np.int64] = view(HISTOGRAM_BINS, np.int64)
        self._rows: Array = view(RING_ROWS * width, np.float64).reshape(RING_ROWS, width)
        self._briefing: NDArray[np.uint8] = np.frombuffer(buffer, np.uint8, BRIEFING_BYTES, offset)
        self._ground_truth: GroundTruth | None = None
        self._request: StreamRequest | None = None

    def write(self, row: Array) -> None:
        """Add a row of telemetry; only the control process may call this."""
        written = int(self.counters[WRITTEN])
        self._rows[written % RING_ROWS] = row
        self.counters[WRITTEN] = written + 1

    def publish_ground_truth(self, truth: GroundTruth, stuck: bool = False) -> None:
        """Write the virtual lab's ground truth and whether its robot is stuck; only the lab may call this."""
        cells = self._truth
        self.counters[STUCK] = stuck
        cells[0] += 1.0
        cells[1:4], cells[4:7], cells[7] = truth.tip, truth.force, truth.target is not None
        cells[11:14] = 0.0 if truth.direction is None else truth.direction
        if truth.target is not None:
            cells[8:11] = truth.target
        cells[0] += 1.0

    def truth(self) -> GroundTruth | None:
        """Return the latest ground truth of the virtual lab; None without a virtual lab."""
        before = self._truth[0]
        values = self._truth.copy()
        if before and not before % 2.0 and values[0] == before and self._truth[0] == before:
            target = values[8:11] if values[7] else None
            self._ground_truth = GroundTruth(values[1:4], values[4:7], target, values[11:14])
        return self._ground_truth  # during a write this is the previous ground truth, because the loop does not wait

    def write_request(self, request: StreamRequest) -> None:
        """Write the latest setpoint request for a streamed tip; only the station process may call this."""
        cells, setpoint = self._request_cells, request.setpoint
        cells[0] += 1.0
        cells[1], cells[2] = request.run, -1.0 if setpoint is None else float(setpoint.position is not None)
        if setpoint is not None:
            cells[3:6], cells[6:9] = 0.0 if setpoint.position is None else setpoint.position, setpoint.velocity
            cells[9], cells[10], cells[11] = setpoint.time, setpoint.extrapolation, setpoint.direction is not None
            cells[12:15] = 0.0 if setpoint.direction is None else setpoint.direction
        cells[0] += 1.0

    def request(self, run: int) -> StreamRequest | None:
        """Return the latest setpoint request of a run, with times by the station's clock; None before the first one."""
        before = self._request_cells[0]
        if not before or self._request_cells[1] != run:
            return None
        values = self._request_cells.copy()
        if not before % 2.0 and values[0] == before and self._request_cells[0] == before:
            setpoint = None
            if values[2] >= 0.0:
                position = values[3:6] if values[2] else None
                direction = values[12:15] if values[11] else None
                setpoint = SetpointRequest(position, values[6:9], float(values[9]), float(values[10]), direction)
            self._request = StreamRequest(run, setpoint)
        # During a write this is the previous request, because the loop does not wait.
        return self._request if self._request is not None and self._request.run == run else None

    def write_briefing(self, briefing: bytes) -> None:
        """Write the description of the stages for `guard.py`; only the station process calls this.

        Raises:
            ValueError: it is too large.
        """
        if len(briefing) > BRIEFING_BYTES:
            raise ValueError(f"the description of the stages has {len(briefing)} bytes of at most {BRIEFING_BYTES}")
        self._briefing[: len(briefing)] = np.frombuffer(briefing, np.uint8)

    def briefing(self) -> bytes:
        """Return the description of the stages, with zeros after it."""
        return self._briefing.tobytes()

    def time_late(self, late: float, skipped: int) -> None:
        """Count the lateness of a tick's start [s] in the histogram, and the whole periods that were skipped."""
        late_us = 1e6 * late
        self.late[min(max(int(late_us), 0), HISTOGRAM_BINS - 1)] += 1
        self.counters[MISSED] += skipped
        if late_us > self.numbers[LATE_MAX]:
            self.numbers[LATE_MAX] = late_us

    def time_work(self, busy: float) -> None:
        """Count the duration of a tick's work [s] in the histogram."""
        busy_us = 1e6 * busy
        self.busy[min(max(int(busy_us), 0), HISTOGRAM_BINS - 1)] += 1
        if busy_us > self.numbers[TICK_MAX]:
            self.numbers[TICK_MAX] = busy_us

    @property
    def written(self) -> int:
        """Number of rows that were written so far."""
        return int(self.counters[WRITTEN])

    def read(self, since: int) -> tuple[Array, int, int]:
        """Return the rows from number `since` on, the number to pass next time, and the number of missed rows."""
        written = self.written
        # Exclude the slot that the writer may be filling now.
        first = max(since, written - RING_ROWS + 1, 0)
        rows = self._rows[np.arange(first, written) % RING_ROWS]
        safe = max(first, self.written - RING_ROWS + 1)
        return rows[safe - first :], written, safe - since if safe > since else 0

    def latest(self) -> Array | None:
        """Return the newest row; None before the first row."""
        rows, _, _ = self.read(max(self.written - 1, 0))
        return rows[-1] if len(rows) else None

    def timing(self) -> Timing:
        """Return the percentiles of the ticks' lateness and work."""
        return Timing(
            int(self.late.sum()),
            int(self.counters[MISSED]),
            _percentiles(self.late, float(self.numbers[LATE_MAX])),
            _percentiles(self.busy, float(self.numbers[TICK_MAX])),
            "SCHED_FIFO" if self.counters[SCHEDULER] else "normal priority",
        )

    def later_than(self, late: float) -> int:
        """Return the number of ticks that started at least `late` [s] after their deadline; `late` is below 5 ms."""
        return int(self.late[int(1e6 * late) :].sum())

    def clear_timing(self) -> None:
        """Reset the timing statistics."""
        self.late[:], self.busy[:] = 0, 0
        self.counters[MISSED] = 0
        self.numbers[LATE_MAX] = self.numbers[TICK_MAX] = 0.0

    def close(self, *, remove: bool) -> None:
        """Detach from the segment; `remove` also deletes it, which is the task of the process that created it."""
        del self.counters, self.numbers, self.late, self.busy
        del self._truth, self._request_cells, self._rows, self._briefing
        self._memory.close()
        if remove:
            with contextlib.suppress(FileNotFoundError):  # another process has removed the segment after a crash
                self._memory.unlink()


def _new_name() -> str:
    """Return a new segment name that contains this process's pid, so that `clear_left_behind` finds its owner."""
    return f"{SEGMENT_PREFIX}{os.getpid()}_{secrets.token_hex(4)}"


def clear_left_behind() -> None:
    """Remove the segments of killed stations, on systems where segments are files (Linux); keep all other segments."""
    for path in SEGMENT_FOLDER.glob(f"{SEGMENT_PREFIX}*"):
        name = _SEGMENT_NAME.fullmatch(path.name)
        with contextlib.suppress(OSError):  # the file belongs to another user, or is already gone
            if name and path.lstat().st_uid == os.getuid() and not exists(int(name[1])):
                path.unlink()


def _percentiles(histogram: NDArray[np.int64], largest: float) -> dict[str, float]:
    total = int(histogram.sum())
    result: dict[str, float] = {}
    for name, part in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
        index = int(np.searchsorted(np.cumsum(histogram), part * total)) if total else 0
        # Use the upper edge of the bin, but at most the measured maximum.
        result[name] = min(float(index + 1), largest) if total else 0.0
    result["max"] = round(largest, 1)
    return result
