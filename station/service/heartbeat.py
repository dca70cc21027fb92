"""Detection of a hung process, which exists but was stopped by a signal, by swapping or by a suspended computer."""

from station.control.clock import StationClock
from station.control.ring import Ring

#: Interval between two reads of a heartbeat [s].
POLL_INTERVAL_S = 0.01


def is_alive(ring: Ring, heartbeat: int, clock: StationClock, patience: float) -> bool:
    """Return whether a process writes its heartbeat (an index of the ring's numbers) within `patience` [s]."""
    before, end = float(ring.numbers[heartbeat]), clock.now() + patience
    while float(ring.numbers[heartbeat]) == before:
        if clock.now() > end:
            return False
        clock.sleep(POLL_INTERVAL_S)
    return True
