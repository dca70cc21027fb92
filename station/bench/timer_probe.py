"""How late the computer itself is: a timer with nothing to do, beside the control loop and before it in rank.

What holds this one up (the kernel, the host of a virtual machine) no program on the computer can do anything about;
the loop can at best be as punctual.
"""

import os
import signal
import time
from multiprocessing.connection import Connection
from typing import Any, Self

from station.config.controllers import PERIOD
from station.control.child import Child
from station.control.realtime import ask_for_fifo, be_punctual, show_as
from station.control.ring import SCHEDULER, Ring

#: Above the control loop and all that belongs to it.
PRIORITY = 90
#: Between two looks whether the one who asked still lives [periods].
LOOK = 500


class TimerProbe:
    """A process that wakes every 2 ms on one processor and counts how late it does. Use it as a context."""

    def __init__(self, core: int | None) -> None:
        """`core`: the control loop's processor; None: any."""
        self._ring = Ring(1)
        self._child = Child(_watch, self._ring.name, core, name="timer probe")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.terminate()
        self._child.ended()
        self._child.pipe.close()
        self._ring.close(remove=True)

    def clear(self) -> None:
        """Begin to count anew."""
        self._ring.clear_timing()

    def figures(self) -> dict[str, Any]:
        """As of the loop: how late, and how often by a period or more."""
        timing = self._ring.timing()
        return {
            "ticks": timing.ticks,
            "late_us": timing.late_us,
            "a_period_late": self._ring.later_than(PERIOD),
            "scheduler": timing.scheduler,
        }


def _watch(ring_name: str, core: int | None, _pipe: Connection, parent: int) -> None:
    """Main function of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who asked decides when it ends
    show_as("ctr-probe")
    ring = Ring(1, ring_name)
    be_punctual(fifo=False, core=core)
    ring.counters[SCHEDULER] = ask_for_fifo(PRIORITY)
    begun, tick = time.monotonic(), 0
    while tick % LOOK or os.getppid() == parent:  # ticks that are skipped put the look off
        due = begun + tick * PERIOD
        left = due - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        late = time.monotonic() - due
        skipped = int(late / PERIOD)
        ring.time_late(late, skipped)
        tick += 1 + skipped
