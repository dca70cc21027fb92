"""Measurement times of the samples of an ATI Net F/T box, from the box's internal counter and the host's clock."""

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array

SAMPLE_RATE_HZ = 7000.0  #: rate of the box's internal counter, +-0.5 % [1/s]
LATENCY_S = 288e-6  #: time from a measurement until the box sends its record on the Ethernet [s]
#: Rate at which the estimated offset rises between records [s/s]: above the box's largest clock error of 0.5 %.
MAX_CLOCK_DRIFT = 0.006
OFFSET, SEEN, CONFIRMED, LATE = range(4)  #: indices in `SampleClock.state`


class SampleClock:
    """Converts the box's internal sample count to host time.

    Records arrive with varying delays but never early. Therefore the least delayed records give the offset between the
    counter and the host's clock. The remaining error is at most the time between two polls of the socket.
    """

    def __init__(self, latency: float = LATENCY_S) -> None:
        #: For compiled code: host time at which the counter was 0, from the least delayed record; time of the last
        #: record; time of the last record with the least delay; latency [s].
        self.state = np.array([np.inf, 0.0, 0.0, latency])

    @property
    def is_set(self) -> bool:
        """Whether at least one record was received."""
        return bool(self.state[OFFSET] < np.inf)

    def observe(self, count: int, now: float) -> float:
        """Record that sample `count` was received at `now` [s], and return the time of its measurement [s]."""
        return observe(self.state, count, now)

    def doubt(self, now: float) -> float:
        """Return the largest possible error of the offset at `now` [s]."""
        return 2.0 * MAX_CLOCK_DRIFT * (now - float(self.state[CONFIRMED]))

    def latest(self, now: float) -> float:
        """Return the largest possible count at `now` [s]."""
        return latest(self.state, now)


@compiled
def observe(clock: Array, count: int, now: float) -> float:
    """Compiled code of `SampleClock.observe`, with the clock's state as first argument."""
    offset = now - count / SAMPLE_RATE_HZ
    drifted = clock[OFFSET] + MAX_CLOCK_DRIFT * (now - clock[SEEN])
    if offset <= drifted:
        clock[OFFSET], clock[CONFIRMED] = offset, now
    else:
        clock[OFFSET] = drifted
    clock[SEEN] = now
    return clock[OFFSET] + count / SAMPLE_RATE_HZ - clock[LATE]


@compiled
def latest(clock: Array, now: float) -> float:
    """Compiled code of `SampleClock.latest`, with the clock's state as first argument."""
    return (now - clock[OFFSET] + 2.0 * MAX_CLOCK_DRIFT * (now - clock[CONFIRMED])) * SAMPLE_RATE_HZ
