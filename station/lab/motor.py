"""A simulated motor that moves a stage: its count, its ramps of constant acceleration, its hard stops, and a stall."""

import math
from collections import deque

from station.lab.zaber_unit import Segment, quickest_motion


class Motor:
    """Motor whose controller counts a position [counts]; the stage's true position may differ by a constant."""

    def __init__(self, true_position: float, count: float, lower: float = -math.inf, upper: float = math.inf) -> None:
        """`lower` and `upper` are the true positions of the hard stops [counts]."""
        self.time = 0.0
        self.acceleration = 1e6  #: [counts/s^2]
        self._lower, self._upper = lower, upper
        self._shift = true_position - count  # true position minus count
        self._stuck: float | None = None
        self._plan: deque[Segment] = deque()
        self._start_time, self._start_position, self._start_velocity = 0.0, count, 0.0  # of the first segment

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [counts]."""
        return self.position + self._shift if self._stuck is None else self._stuck

    @property
    def position(self) -> float:
        """Position that the controller counts."""
        if not self._plan:
            return self._start_position
        step = self.time - self._start_time
        return self._start_position + (self._start_velocity + 0.5 * self._plan[0].acceleration * step) * step

    @property
    def velocity(self) -> float:
        """Present velocity [counts/s]."""
        if not self._plan:
            return 0.0
        return self._start_velocity + self._plan[0].acceleration * (self.time - self._start_time)

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress."""
        return bool(self._plan)

    @property
    def stalled(self) -> bool:
        """Whether the stage does not follow its motor."""
        return self._stuck is not None

    def move(self, goal: float, top: float) -> None:
        """Start the fastest motion to rest at the count `goal` with at most the speed `top` [counts/s]."""
        self._begin(list(quickest_motion(self.position, self.velocity, goal, top, self.acceleration)))

    def run(self, velocity: float, lower: float, upper: float) -> None:
        """Run at a velocity [counts/s] until the count reaches a limit; brake at once beyond a limit."""
        present = self.velocity
        rest = self.position + present * abs(present) / (2.0 * self.acceleration)
        limit = upper if velocity > 0.0 else lower
        if velocity == 0.0 or (limit - rest) * velocity <= 0.0:
            self.stop()
        elif math.isfinite(limit):
            self.move(limit, abs(velocity))
        else:
            change = velocity - present
            ramp = Segment(abs(change) / self.acceleration, math.copysign(self.acceleration, change))
            self._begin([ramp, Segment(math.inf, 0.0)])

    def stop(self) -> None:
        """Brake to rest."""
        velocity = self.velocity
        ramp = Segment(abs(velocity) / self.acceleration, -math.copysign(self.acceleration, velocity))
        self._begin([ramp] if velocity else [])

    def halt(self) -> None:
        """Stop without a ramp."""
        self._begin([])
        self._start_velocity = 0.0

    def set_count(self, count: float) -> None:
        """Set the count of the present position; a motion ends."""
        self._shift += self.position - count
        self._plan.clear()
        self._start_position, self._start_velocity = count, 0.0

    def stall(self, stalled: bool) -> None:
        """Start or end a stall, in which the motor turns without moving the stage."""
        if stalled and self._stuck is None:
            self._stuck = self.true_position
        elif not stalled and self._stuck is not None:
            self._shift, self._stuck = self._stuck - self.position, None

    def advance(self, until: float) -> None:
        """Run the motor until the time `until` [s]."""
        while self._plan and self._start_time + self._plan[0].duration <= until:
            self.time = self._start_time + self._plan[0].duration
            position, velocity = self.position, self.velocity
            self._plan.popleft()
            self._start_time, self._start_position, self._start_velocity = self.time, position, velocity
        self.time = until
        true = self.position + self._shift
        if not self._lower <= true <= self._upper:
            self._shift += min(max(true, self._lower), self._upper) - true  # counts lost at a hard stop

    def _begin(self, plan: list[Segment]) -> None:
        position, velocity = self.position, self.velocity
        self._start_time, self._start_position, self._start_velocity = self.time, position, velocity
        self._plan = deque(plan)
