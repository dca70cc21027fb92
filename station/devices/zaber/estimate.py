"""Estimates from the replies of Zaber units: the position of an axis, and the backlog of the line.

The estimate integrates the unit's velocity ramps. Each velocity sent by the host counts from the time of its effect. A
reading is compared with the position that was estimated for the moment of the reading. Messages have no checksum.
Therefore a reading far from the estimate is accepted only after other readings agree with this reading.
"""

import math
from collections import deque

#: A reading whose error is larger than the sum of two tolerances is accepted only when two more readings agree with it.
READING_TOLERANCE = 16.0  # constant tolerance [microsteps]
READING_TOLERANCE_S = 0.012  # the present speed times this duration is the second tolerance [s]
#: An axis counts as not moving as commanded after this number of implausible readings in a row.
MAX_UNEXPECTED_READINGS = 8
#: The same applies after three consistent readings whose error is above the travel in this time at top speed [s]: the
#: unit was probably reset.
MAX_JUMP = 0.5


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
            tolerance: largest error of the time at which the unit executes a command or reads [s].
            memory: fraction of the speed at a reading that also counts at the next reading, for units that execute
                commands from a queue.
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

    def forget(self, adrift: bool = False) -> None:
        """Discard the position. The next two readings that agree confirm a new one, unless the axis is adrift."""
        self.known, self.adrift, self.rejected = False, adrift, 0
        self._velocity = self._target = 0.0
        self._ahead.clear()
        self._doubts.clear()

    def command(self, velocity: float, when: float) -> None:
        """Add a commanded velocity [microsteps/s] that takes effect at `when` [s]."""
        self._ahead.append((when, velocity))

    def expect(self, when: float) -> None:
        """Note that the unit reads its position at `when` [s]."""
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
        self.position = min(max(self.position + delta, 0.0), self._maximum)
        return True

    @property
    def doubtful(self) -> bool:
        """Whether the last reading needs confirmation."""
        return self.known and bool(self._doubts)

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


#: Number of late replies in a row that indicate a backlog; an adapter may delay single replies by up to 16 ms.
LATE_REPLIES = 12
#: Smallest backlog for which the host pauses [s].
MIN_BACKLOG_S = 0.004


class Backlog:
    """Backlog of one serial line: the time that sent bytes wait for transmission.

    While the controller moves the robot, the host uses the full capacity of the line. If the operating system, an
    adapter or a slightly slower clock delays a message, all following messages are delayed as well, and this delay does
    not decrease. An idle line has no backlog, so replies on an idle line give the smallest delay.
    """

    def __init__(self) -> None:
        self._best = math.inf  # smallest delay of replies to requests on an idle line [s]
        self._late: deque[float] = deque(maxlen=LATE_REPLIES)
        self._paused = math.inf  # duration of the last pause [s]

    def observe(self, late: float, idle: bool) -> float:
        """Record a reply, and return the time by which the host must pause [s]; 0: no pause.

        Args:
            late: delay of the reply after its expected time [s].
            idle: whether the line was idle before the reply's request.
        """
        if idle:
            self._best = min(self._best, late)
            self._late.clear()
            return 0.0
        self._late.append(late)
        if len(self._late) < LATE_REPLIES or self._best == math.inf:
            return 0.0
        behind = min(self._late) - self._best
        self._late.clear()
        if behind < MIN_BACKLOG_S:
            self._paused = math.inf
            return 0.0
        if behind > 0.5 * self._paused:
            self._best += behind  # the last pause had no effect, so this delay is normal for a busy line
            return 0.0
        self._paused = behind
        return behind
