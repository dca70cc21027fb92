"""Where a Zaber axis is between two readings, and which readings are believed.

The unit's own ramps are followed from the velocities that were sent, each from the moment of its effect; a
reading is compared with where the axis was expected when the unit took it. There is no checksum, so that a
reading far from that counts only once others agree with it.
"""

import math
from collections import deque

#: A reading this far from what was expected needs two more that agree with it: there is no checksum.
SLACK = 16.0  # [microsteps], and so much time at the present speed [s]:
SLACK_TIME = 0.012
#: So many readings in a row that fit nothing mean that the axis does not move as it was told, and so do three
#: that agree on a place farther off than the axis gets in this time at its top speed (a unit that was reset).
UNEXPECTED_READINGS = 8
JUMP = 0.5  # [s]


class Estimate:
    """Where an axis is [microsteps], from what was sent and what came back."""

    def __init__(self, top: float, acceleration: float, maximum: float) -> None:
        self._jump = JUMP * top
        self.position = math.nan
        self.known = False  #: until then `position` is only the last reading
        self.adrift = False  #: it moves by itself: homing, or not as it was told
        self.rejected = 0  #: readings in a row
        self._acceleration, self._maximum = acceleration, maximum
        self._velocity = self._target = self._fastest = 0.0
        self._time = -math.inf
        self._ahead: deque[tuple[float, float | None]] = deque()
        self._sample = math.nan
        self._doubts: list[float] = []

    def forget(self, adrift: bool = False) -> None:
        """The axis may be anywhere: believe the next two readings that agree, or none while it is adrift."""
        self.known, self.adrift, self.rejected = False, adrift, 0
        self._velocity = self._target = 0.0
        self._ahead.clear()
        self._doubts.clear()

    def command(self, velocity: float, when: float) -> None:
        """A velocity [microsteps/s] that takes effect at `when` [s]."""
        self._ahead.append((when, velocity))

    def expect(self, when: float) -> None:
        """The unit reads its position at `when` [s]."""
        self._ahead.append((when, None))

    def advance(self, now: float) -> None:
        """Let time pass."""
        ahead = self._ahead
        while ahead and ahead[0][0] <= now:
            when, velocity = ahead.popleft()
            self._run(when)
            if velocity is None:
                self._sample = self.position
                self._fastest = max(abs(self._velocity), abs(self._target))
            else:
                self._target = velocity
        self._run(now)

    def correct(self, reading: int) -> bool:
        """Take in a position that the unit read when it was expected to; False: it fits nothing, so wait."""
        if not self.known:
            self._doubts = [*self._doubts[-1:], float(reading)]
            self.position = self._sample = float(reading)
            agree = len(self._doubts) == 2 and abs(self._doubts[0] - self._doubts[1]) <= SLACK
            if agree and not self.adrift:
                self.known = True
                self._doubts.clear()
            return True
        delta = reading - self._sample
        slack = SLACK + SLACK_TIME * self._fastest
        if abs(delta) > slack:
            agree = [doubt for doubt in self._doubts if abs(doubt - delta) <= slack]
            self._doubts = [*agree, delta]
            if len(self._doubts) < 3:
                self.rejected += 1
                return False
            if abs(delta) > self._jump:
                self.rejected = UNEXPECTED_READINGS
                return False
        self._doubts.clear()
        self.rejected = 0
        self.position = min(max(self.position + delta, 0.0), self._maximum)
        return True

    @property
    def doubtful(self) -> bool:
        """The last reading waits to be confirmed."""
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
            most = self._acceleration * time
            change = min(max(change, -most), most)
            position += change * (time - 0.5 * abs(change) / self._acceleration)
            self._velocity = velocity + change
        if not 0.0 <= position <= self._maximum:  # the unit does not go further
            position = min(max(position, 0.0), self._maximum)
        self.position = position
