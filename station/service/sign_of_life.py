"""Whether a process goes on or stands still: it lives, but a signal, a swap storm or a suspended computer holds it."""

from station.control.clock import StationClock
from station.control.ring import Ring

#: Between two looks [s].
LOOK = 0.01


def goes_on(ring: Ring, heartbeat: int, clock: StationClock, patience: float) -> bool:
    """Whether that heartbeat (a place of the ring's numbers) beats again within `patience` [s]."""
    before, end = float(ring.numbers[heartbeat]), clock.now() + patience
    while float(ring.numbers[heartbeat]) == before:
        if clock.now() > end:
            return False
        clock.sleep(LOOK)
    return True
