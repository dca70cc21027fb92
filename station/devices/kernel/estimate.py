"""Estimate of the position of an axis from the velocities sent and the positions received.

The estimate integrates the velocity ramps of the axis. Each velocity sent by the host counts from the time of its
effect. A reading is compared with the position that was estimated for the moment of the reading. A message may be
damaged. Therefore a reading far from the estimate is accepted only after other readings agree with this reading.

If an axis is blocked, each reading differs from the estimate only a little, and corrects it. To detect this case, the
estimate also compares the motion that was commanded with the motion that was counted in the last `MEMORY_S`.
"""

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

#: A reading whose error is larger than the sum of two tolerances is accepted only when two more readings agree with it.
READING_TOLERANCE = 16.0  # constant tolerance [microsteps]
READING_TOLERANCE_S = 0.012  # the present speed times this duration is the second tolerance [s]
#: An axis counts as not moving as commanded after this number of implausible readings in a row.
MAX_UNEXPECTED_READINGS = 8
#: An axis also counts as not moving as commanded after three consistent readings whose error exceeds the travel in this
#: time at top speed [s]: the unit was probably reset.
MAX_JUMP = 0.5

#: Span of the comparison of commanded and counted motion [s], smallest step between its readings [s], and shortest
#: commanded motion that is judged [s]; a lost velocity is sent again within a shorter time.
MEMORY_S, MEMORY_STEP_S, MEMORY_MIN_S = 0.8, 0.02, 0.5
#: An axis is blocked if its counts change by less than the first share of the commanded motion. It moves in the
#: opposite direction if they change against the command by more than the second share.
STILL_SHARE, OPPOSITE_SHARE = 0.25, 0.5
#: Speed up to which an axis counts as at rest [counts/s].
SLOW = 1.0
#: Motion that the rounding of positions and velocities may hide [counts].
ROUNDING = 2.0
#: Number of newest readings that show whether an axis that does not move as commanded is at rest.
LAST = 3


class _Compared(NamedTuple):
    """A reading, and the motion that was commanded until then."""

    time: float  #: [s]
    commanded: float  #: position that the commands alone give [microsteps]
    counted: float  #: the reading [microsteps]
    speed: float  #: speed at the reading [microsteps/s]
    accepted: bool  #: whether the reading was plausible


def _opposite(first: _Compared, last: _Compared, least: float) -> bool:
    """Return whether an axis moved against a commanded motion of more than `least` counts between two readings."""
    ahead, gone = last.commanded - first.commanded, last.counted - first.counted
    return abs(ahead) > least and gone * ahead < -OPPOSITE_SHARE * ahead**2


def _extent(values: Sequence[float]) -> float:
    return max(values, default=0.0) - min(values, default=0.0)


class AxisEstimate:
    """Estimated position of an axis [microsteps], from the velocities sent and the positions received."""

    def __init__(
        self,
        top: float,
        acceleration: float,
        maximum: float,
        tolerance: float = READING_TOLERANCE_S,
        memory: float = 0.0,
    ) -> None:
        """Create the estimate of an axis whose position is unknown.

        Args:
            top, acceleration, maximum: largest speed, acceleration and position, in microsteps and seconds.
            tolerance: largest error of the time at which the unit executes a command or reads its position [s].
            memory: fraction of the speed at a reading that also widens the tolerance at the next reading, for units
                that execute commands from a queue.
        """
        self._jump = MAX_JUMP * top
        self._tolerance, self._memory = tolerance, memory
        self.position = math.nan
        self.known = False  #: whether readings have confirmed the position; False: `position` is the last reading
        self.adrift = False  #: whether the axis moves independently of commanded velocities, as during homing
        self.rejected = 0  #: rejected readings in a row
        self._acceleration, self._maximum = acceleration, maximum
        self._velocity = self._target = self._fastest = 0.0
        self._time = -math.inf
        self._ahead: deque[tuple[float, float | None]] = deque()
        self._sample = math.nan
        self._doubts: list[float] = []
        self._corrected = 0.0  # sum of all corrections [microsteps]
        self._compared: deque[_Compared] = deque()

    def forget(self, adrift: bool = False) -> None:
        """Discard the position. The next two readings that agree confirm a new one, unless the axis is adrift."""
        self.known, self.adrift, self.rejected = False, adrift, 0
        self._velocity = self._target = 0.0
        self._ahead.clear()
        self._doubts.clear()
        self._compared.clear()

    def command(self, velocity: float, when: float) -> None:
        """Add a commanded velocity [microsteps/s] that takes effect at `when` [s]."""
        self._ahead.append((when, velocity))

    def expect(self, when: float) -> None:
        """Record that the unit reads its position at `when` [s]."""
        self._ahead.append((when, None))

    def advance(self, now: float) -> None:
        """Advance the estimate to `now` [s]."""
        ahead = self._ahead
        if not ahead and self._velocity == self._target == 0.0:
            self._time = max(self._time, now)  # at rest
            return
        while ahead and ahead[0][0] <= now:
            when, velocity = ahead.popleft()
            self._run(when)
            if velocity is None:
                self._sample = self.position
                self._fastest = max(abs(self._velocity), abs(self._target), self._memory * self._fastest)
            else:
                self._target = velocity
        self._run(now)

    def correct(self, reading: int) -> bool:
        """Correct the estimate by a position reading; return False if the reading is implausible."""
        if not self.known:
            self._doubts = [*self._doubts[-1:], float(reading)]
            self.position = self._sample = float(reading)
            agree = len(self._doubts) == 2 and abs(self._doubts[0] - self._doubts[1]) <= READING_TOLERANCE
            if agree and not self.adrift:
                self.known = True
                self._doubts.clear()
            return True
        commanded = self._sample - self._corrected
        accepted = self._accepts(reading)
        if self._disobeys(commanded, reading, accepted):
            self.rejected = MAX_UNEXPECTED_READINGS
            return False
        return accepted

    def _accepts(self, reading: int) -> bool:
        """Return whether a reading is plausible; if so, correct the estimate by it."""
        delta = reading - self._sample
        slack = READING_TOLERANCE + self._tolerance * self._fastest
        if abs(delta) > slack:
            agree = [doubt for doubt in self._doubts if abs(doubt - delta) <= slack]
            self._doubts = [*agree, delta]
            if len(self._doubts) < 3:
                self.rejected += 1
                return False
            if abs(delta) > self._jump:
                self.rejected = MAX_UNEXPECTED_READINGS
                return False
        self._doubts.clear()
        self.rejected = 0
        corrected = min(max(self.position + delta, 0.0), self._maximum)
        self._corrected += corrected - self.position
        self.position = corrected
        return True

    @property
    def disobedience(self) -> str:
        """Text about how the axis disobeys its commands, after `rejected` has reached `MAX_UNEXPECTED_READINGS`."""
        last = list(self._compared)[-LAST:]
        if _extent([one.counted for one in last]) <= ROUNDING < _extent([one.commanded for one in last]):
            return "does not move although it is commanded to; is it blocked, or held by a limit or emergency stop?"
        return "does not move as commanded; was it reset, or moved by another program?"

    @property
    def doubtful(self) -> bool:
        """Whether the last reading needs confirmation."""
        return self.known and bool(self._doubts)

    def _disobeys(self, commanded: float, counted: float, accepted: bool) -> bool:
        """Return whether the readings show that the axis rests despite its commands, or moves against them.

        Rejected readings may be damaged, so they only count as a sign of motion.
        """
        memory = self._compared
        if memory and self._time - memory[-1].time < MEMORY_STEP_S:
            return False
        memory.append(_Compared(self._time, commanded, counted, self._fastest, accepted))
        while self._time - memory[0].time > MEMORY_S:
            memory.popleft()
        moving = [one for one in memory if one.speed > SLOW]
        if not moving or self._time - moving[0].time < MEMORY_MIN_S:
            return False
        wanted = _extent([one.commanded for one in memory])
        hidden = ROUNDING + 2.0 * self._tolerance * max(one.speed for one in moving)  # uncertain motion [counts]
        if _extent([one.counted for one in memory]) + hidden < STILL_SHARE * wanted:
            return True
        good = [one for one in memory if one.accepted]
        middle = len(good) // 2
        return middle > 0 and all(_opposite(*pair, READING_TOLERANCE + hidden) for pair in pairwise(good[::middle]))

    def _run(self, until: float) -> None:
        time = until - self._time
        if time <= 0.0:
            return
        self._time = until
        velocity = self._velocity
        change = self._target - velocity
        if not self.known or (change == 0.0 and velocity == 0.0):
            return
        position = self.position + velocity * time
        if change != 0.0:
            max_change = self._acceleration * time
            change = min(max(change, -max_change), max_change)
            position += change * (time - 0.5 * abs(change) / self._acceleration)
            self._velocity = velocity + change
        if not 0.0 <= position <= self._maximum:  # the unit stops at the ends of its travel
            position, self._velocity = min(max(position, 0.0), self._maximum), 0.0
        self.position = position
