"""Check, in the control process, whether the station process is alive.

The watchdog thread of the station process writes a heartbeat, for which it needs the interpreter's lock. On a busy
computer other threads of that process may keep the lock for seconds. Therefore the kernel is queried as well: a process
that uses processor time is alive, and a process that is suspended or starved uses none.
"""

import math

from station.control.clock import StationClock
from station.control.realtime import processor_time
from station.control.ring import STATION_HEARTBEAT, Ring

#: Age of a heartbeat from which on the kernel is queried, and interval between two queries [s].
DOUBT_S, POLL_INTERVAL_S = 0.2, 0.05


class StationLife:
    """Evidence that the station process is alive: its heartbeat, and the processor time that it uses."""

    def __init__(self, ring: Ring, clock: StationClock, pid: int) -> None:
        self._ring, self._clock, self._pid = ring, clock, pid
        self._used: float | None = None  # processor time at the last query; None: no query since the last heartbeat
        self._queried = self._worked = -math.inf

    @property
    def silence(self) -> float:
        """Time since the last heartbeat of the station process [s]."""
        return self._clock.now() - float(self._ring.numbers[STATION_HEARTBEAT])

    def standstill(self) -> float:
        """Return the time since the last heartbeat or use of a processor [s]; call this at every tick."""
        silence, now = self.silence, self._clock.now()
        if silence < DOUBT_S:
            self._used = None
        elif now - self._queried >= POLL_INTERVAL_S:
            used, self._queried = processor_time(self._pid), now
            if used is not None and self._used not in (None, used):
                self._worked = now
            self._used = used
        return min(silence, now - self._worked)
