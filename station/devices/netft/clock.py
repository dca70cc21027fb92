"""When an ATI Net F/T took a sample, by its internal counter and the host's clock."""

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array

SAMPLE_RATE = 7000.0  #: of the box's internal counter, +-0.5 % [1/s]
LATENCY = 288e-6  #: from the event to the Ethernet [s]
#: The box's clock may drift by +-0.5 %; the estimate of its offset gives way a little faster.
DRIFT = 0.006
OFFSET, SEEN, CONFIRMED, LATE = range(4)  #: in the state of a clock


class SampleClock:
    """Host time of the box's internal samples.

    Records are delayed by more or less, never early: the least delayed ones say how far the counter
    and the host's clock are apart. What remains is at most the time between two looks at the socket.
    """

    def __init__(self, latency: float = LATENCY) -> None:
        #: For compiled code: host time at which the counter was 0, as the least delayed record says; when there was
        #: a record; when one of the least delayed; the latency [s].
        self.state = np.array([np.inf, 0.0, 0.0, latency])

    @property
    def is_set(self) -> bool:
        """Whether there has been a record at all."""
        return bool(self.state[OFFSET] < np.inf)

    def observe(self, count: int, now: float) -> float:
        """Note that sample `count` is here at `now` [s], and say when it was measured [s]."""
        return observe(self.state, count, now)

    def doubt(self, now: float) -> float:
        """By how much the offset may be off at `now` [s]."""
        return 2.0 * DRIFT * (now - float(self.state[CONFIRMED]))

    def latest(self, now: float) -> float:
        """The count that can be here at `now` [s] at the latest."""
        return latest(self.state, now)


@compiled
def observe(clock: Array, count: int, now: float) -> float:
    """`SampleClock.observe` on its state."""
    offset = now - count / SAMPLE_RATE
    drifted = clock[OFFSET] + DRIFT * (now - clock[SEEN])
    if offset <= drifted:
        clock[OFFSET], clock[CONFIRMED] = offset, now
    else:
        clock[OFFSET] = drifted
    clock[SEEN] = now
    return clock[OFFSET] + count / SAMPLE_RATE - clock[LATE]


@compiled
def latest(clock: Array, now: float) -> float:
    """`SampleClock.latest` on its state."""
    return (now - clock[OFFSET] + 2.0 * DRIFT * (now - clock[CONFIRMED])) * SAMPLE_RATE
