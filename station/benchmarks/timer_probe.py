"""Lateness of the computer itself: a timer without work on the control loop's processor, with a higher priority.

The kernel or the host of a virtual machine delays this timer, and no program on the computer can prevent such a delay.
The lateness of the timer is the lower bound of the loop's lateness.
"""

import os
import signal
import time
from multiprocessing.connection import Connection
from typing import Any, Self

from station.config.controllers import PERIOD_S
from station.control.child_process import ChildProcess
from station.control.realtime import request_fifo, request_realtime, set_process_name
from station.control.ring import SCHEDULER, Ring

#: Real-time priority of the timer, above that of the control loop and of its other threads.
PRIORITY = 90
#: Interval at which the timer checks whether its parent process is alive [periods of 2 ms].
PARENT_CHECK_PERIODS = 500


class TimerProbe:
    """Process that wakes every 2 ms on one processor and records its lateness; used in a `with` block."""

    def __init__(self, core: int | None) -> None:
        """Start the process on `core`, the processor of the control loop; None: on any processor."""
        self._ring = Ring(1)
        self._child = ChildProcess(_watch, self._ring.name, core, name="timer probe")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.terminate()
        self._child.ended()
        self._child.pipe.close()
        self._ring.close(remove=True)

    def clear(self) -> None:
        """Clear the recorded lateness."""
        self._ring.clear_timing()

    def figures(self) -> dict[str, Any]:
        """Return the lateness of the timer, and the number of its ticks that were a period late or more."""
        timing = self._ring.timing()
        return {
            "ticks": timing.ticks,
            "late_us": timing.late_us,
            "a_period_late": self._ring.later_than(PERIOD_S),
            "scheduler": timing.scheduler,
        }


def _watch(ring_name: str, core: int | None, _pipe: Connection, parent: int) -> None:
    """Main function of the timer's process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends it
    set_process_name("ctr-probe")
    ring = Ring(1, ring_name)
    request_realtime(fifo=False, core=core)
    ring.counters[SCHEDULER] = request_fifo(PRIORITY)
    start, tick = time.monotonic(), 0
    while tick % PARENT_CHECK_PERIODS or os.getppid() == parent:  # a late timer skips ticks, which may delay this check
        due = start + tick * PERIOD_S
        left = due - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        late = time.monotonic() - due
        skipped = int(late / PERIOD_S)
        ring.time_late(late, skipped)
        tick += 1 + skipped
