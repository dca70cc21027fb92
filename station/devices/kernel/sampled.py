"""Clock of sampled data: converts a device's counter of frames or samples to the time of the station.

A message with a sample can be late but never early. The difference between its arrival and its counter is therefore an
upper bound of the offset between the two clocks, and the least delayed messages give the best bound. Between these
messages the bound rises by the largest drift of the clocks. All times are those of the station's clock, in seconds.
"""

import math

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array

#: Length of a block of samples, whose least delayed sample is compared with those of earlier blocks [s].
BLOCK_S = 1.0
#: Largest change of the least delay that counts as jitter [s]. A larger change in two spans means a wrong rate.
JITTER_S = 0.04
#: If every sample of this number of successive blocks is late by more than `JITTER_S`, the counter has paused: then the
#: offset rises to that of the least delayed sample.
LATE_BLOCKS = 5
#: A measured rate is reported as wrong if its relative difference from the expected rate is larger than this value.
MAX_RATE_ERROR = 0.01
#: Largest delay of a sample [s], and number of consistent samples after which a count that does not fit the clock is
#: accepted: the device has restarted its counter.
MAX_DELAY_S, SAMPLES_TO_RESTART = 1.0, 5
#: Shortest duration of these samples if the count has not decreased [s]. If the rate is so wrong that the delay reaches
#: `MAX_DELAY_S` within three blocks, the samples deviate by more than the jitter in this time.
CONTINUING_S = 0.3

#: Indices of a clock's state. RATE of the counter [1/s]; largest DRIFT [s/s]; OFFSET: time at which the counter was 0;
#: SEEN, CONFIRMED: times of the last sample and of the last one with the least delay; UNTIL: end of the present block;
#: LEAST, FIRST: offset of the least delayed sample of the present block, and of the span's first block (..._AT: time);
#: RISE of the offset in the last span with too large a change [s/s]; LATE blocks; least LATENCY of a message [s];
#: SHIFT of the offset to that of later samples [s].
RATE, DRIFT, OFFSET, SEEN, CONFIRMED, UNTIL, LEAST, LEAST_AT, FIRST, FIRST_AT, RISE, LATE, LATENCY, SHIFT = range(14)


@compiled
def _end_block(clock: Array, count: float, now: float) -> None:
    """Compare the least delays of blocks; correct the rate if the offset changes equally in two successive spans."""
    least, at = clock[LEAST], clock[LEAST_AT]
    clock[LEAST], clock[UNTIL] = np.inf, now + BLOCK_S
    clock[LATE] = clock[LATE] + 1.0 if least - clock[OFFSET] > JITTER_S else 0.0
    if clock[LATE] >= LATE_BLOCKS:
        clock[SHIFT] += least - clock[OFFSET]
        clock[OFFSET], clock[LATE] = least, 0.0
    if clock[FIRST] == np.inf:
        clock[FIRST], clock[FIRST_AT] = least, at
        return
    change, span = least - clock[FIRST], max(at - clock[FIRST_AT], BLOCK_S)
    if abs(change) <= clock[DRIFT] * span + JITTER_S:
        return
    rise = change / span
    if rise < 1.0 and abs(rise - clock[RISE]) < 0.5 * abs(rise):
        clock[RATE] *= 1.0 - rise
        clock[DRIFT] = max(clock[DRIFT], JITTER_S / span)  # the accuracy of the measured rate
        clock[OFFSET], clock[FIRST], clock[RISE] = now - count / clock[RATE], np.inf, 0.0
    else:  # perhaps only the delay has changed
        clock[FIRST], clock[FIRST_AT], clock[RISE] = least, at, rise


def _observe(clock: Array, count: float, now: float) -> float:
    """Record that sample `count` arrived at `now` [s], and return the time of its measurement [s].

    `clock` is the state of a `SampleClock`.
    """
    offset = now - count / clock[RATE]
    if clock[OFFSET] == np.inf:
        clock[UNTIL] = now + BLOCK_S
    drifted = clock[OFFSET] + clock[DRIFT] * (now - clock[SEEN])
    if offset <= drifted:
        if clock[OFFSET] - offset > 0.25 * JITTER_S:
            clock[SHIFT] = max(0.0, clock[SHIFT] - (clock[OFFSET] - offset))
        clock[OFFSET], clock[CONFIRMED] = offset, now
    else:
        clock[OFFSET] = drifted
    clock[SEEN] = now
    if offset < clock[LEAST]:
        clock[LEAST], clock[LEAST_AT] = offset, now
    if now >= clock[UNTIL]:
        _end_block(clock, float(count), now)
    return clock[OFFSET] + count / clock[RATE] - clock[LATENCY]


@compiled
def latest(clock: Array, now: float) -> float:
    """Return the largest count that can have arrived by `now` [s]."""
    return (now - clock[OFFSET] + 2.0 * clock[DRIFT] * (now - clock[CONFIRMED])) * clock[RATE]


#: Compiled `_observe`, for drivers whose other code is compiled as well.
observe = compiled(_observe)


class SampleClock:
    """Time of each sample of one device, from the number of the sample.

    A computed time is never too early if the counter's rate is right within the drift, and too late by at most the
    smallest delay of the recent samples. A wrong rate is measured within seconds, and replaces the expected one.
    """

    def __init__(self, rate: float, drift: float, latency: float = 0.0, wrap: int = 0) -> None:
        """Create the clock.

        Args:
            rate: expected rate of the counter [1/s].
            drift: largest relative difference of the rate, and of the station's clock [s/s].
            latency: least delay from a measurement until its message arrives [s].
            wrap: number of different counts, after which the counter starts again at 0; 0: the counter never wraps.
        """
        self._expected, self._drift, self._latency, self._wrap = rate, drift, latency, wrap
        self.state = np.zeros(SHIFT + 1)  #: state for compiled code
        self._time = -math.inf
        observe(self.state + 1.0, 0, 0.0)  # load the compiled code now, because that takes longer than a tick
        _end_block(self.state + 1.0, 0.0, 0.0)
        self.restart()

    def restart(self) -> None:
        """Forget all samples, because the device may restart its counter."""
        self._start(self._expected, self._drift)

    def _start(self, rate: float, drift: float) -> None:
        self.state[:] = rate, drift, np.inf, 0.0, 0.0, np.inf, np.inf, 0.0, np.inf, 0.0, 0.0, 0.0, self._latency, 0.0
        self._count, self._doubted = 0, list[tuple[int, float]]()
        self._candidate = 0.0  # rate of the doubted samples before those in `_doubted` [1/s]

    @property
    def is_set(self) -> bool:
        """Whether at least one sample has arrived."""
        return bool(self.state[OFFSET] < np.inf)

    @property
    def wrong_rate(self) -> float | None:
        """Measured rate of the counter [1/s]; None if it is the expected one."""
        rate = float(self.state[RATE])
        return rate if abs(rate - self._expected) > max(MAX_RATE_ERROR, self._drift) * self._expected else None

    @property
    def shift(self) -> float:
        """Time by which all samples arrive later than earlier ones did, and which their times do not contain [s].

        Either the delay has increased, so that the samples are older than their times, or the counter has paused.
        """
        return float(self.state[SHIFT])

    def observe(self, count: float, now: float) -> float:
        """Record that sample `count` arrived at `now` [s], and return the time of its measurement [s]."""
        return float(_observe(self.state, count, now))

    def time(self, count: float) -> float:
        """Return the time of the measurement of the sample `count` [s]."""
        return float(self.state[OFFSET] + count / self.state[RATE] - self.state[LATENCY])

    def latest(self, now: float) -> float:
        """Return the largest count that can have arrived by `now` [s]."""
        return float(latest(self.state, now))

    def doubt(self, now: float) -> float:
        """Return the largest possible error of the offset at `now` [s]."""
        return float(2.0 * self.state[DRIFT] * (now - self.state[CONFIRMED]))

    def unwrapped(self, count: int, now: float) -> int:
        """Return a count without wrap-around: the number nearest to the count that is expected at `now` [s]."""
        if not (self._wrap and self.is_set):
            return count
        expected, half = round(self.latest(now)), self._wrap // 2
        return expected + (count - expected + half) % self._wrap - half

    def measured(self, count: int, now: float) -> float | None:
        """Return the time of the measurement of the sample `count`, which arrived at `now` [s].

        Return None if the count does not fit the clock. After a restart of the counter, or at a rate that was not
        expected, the clock accepts new counts after some samples. The returned times increase.
        """
        count = self.unwrapped(count, now)
        if not self.is_set:
            return self._anchor(count, now)
        state = self.state
        late = now - count / state[RATE] - (state[OFFSET] + state[DRIFT] * (now - state[SEEN]))
        if count <= self._count or not -JITTER_S <= late <= MAX_DELAY_S:
            return self._doubt(count, now)
        self._doubted, self._candidate, self._count = [], 0.0, count
        self._time = max(self.observe(count, now), self._time + 1e-6)
        return self._time

    def _anchor(self, count: int, now: float, rate: float = 0.0) -> float:
        """Start the clock again at the sample `count`, with the measured `rate`; 0: with the present rate."""
        drift = JITTER_S / BLOCK_S if rate else float(self.state[DRIFT])
        self._start(rate or float(self.state[RATE]), drift)
        self.observe(count, now)
        self._count, self._time = count, max(now - self._latency, self._time + 1e-6)
        return self._time

    def _doubt(self, count: int, now: float) -> float | None:
        """Collect samples that are consistent with one another but not with the clock, until they replace it."""
        if self._doubted and count == self._doubted[-1][0]:
            return None  # a repetition: the sample was requested again before the next one was measured
        if self._doubted and count < self._doubted[-1][0]:
            self._doubted, self._candidate = [], 0.0
        self._doubted.append((count, now))
        first, begun = self._doubted[0]
        continues = count > self._count
        if not continues:
            first, begun = self._doubted[-SAMPLES_TO_RESTART:][0]
        wrong = abs(now - begun - (count - first) / float(self.state[RATE])) > JITTER_S
        span = CONTINUING_S if continues else 0.0
        if len(self._doubted) >= SAMPLES_TO_RESTART and now - begun >= span and not wrong:
            return self._anchor(count, now)
        first, begun = self._doubted[0]
        if now - begun < BLOCK_S:
            return None
        before, self._candidate = self._candidate, (count - first) / (now - begun)
        self._doubted = [(count, now)]
        agrees = abs(self._candidate - before) < 0.5 * before
        return self._anchor(count, now, self._candidate) if agrees else None
