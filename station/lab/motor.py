"""A simulated motor that moves a stage: its count, ramps of constant acceleration, hard stops, stalls and clamps."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

STOPS = 2000.0  #: distance of the hard stops from both ends of the travel [counts]


class Segment(NamedTuple):
    """Segment of a motion with constant acceleration."""

    duration: float  #: [s]
    acceleration: float  #: [counts/s^2]


def quickest_motion(position: float, velocity: float, goal: float, top: float, acceleration: float) -> list[Segment]:
    """Return the fastest motion to rest at `goal` [counts] at no more than `top` [counts/s]."""
    rest = position + velocity * abs(velocity) / (2.0 * acceleration)
    side = 1.0 if goal >= rest else -1.0
    distance, speed = side * (goal - position), side * velocity
    peak = min(top, math.sqrt(max(0.0, acceleration * distance + 0.5 * speed * speed)))
    ramp = acceleration if peak >= speed else -acceleration
    cruise = distance - (peak * peak - speed * speed) / (2.0 * ramp) - peak * peak / (2.0 * acceleration)
    segments = [Segment(abs(peak - speed) / acceleration, side * ramp)]
    if peak > 0.0:
        segments += [Segment(max(0.0, cruise) / peak, 0.0), Segment(peak / acceleration, -side * acceleration)]
    return segments


class Motor:
    """Motor whose controller counts a position [counts]; the stage's true position may differ by a constant."""

    def __init__(self, true_position: float, count: float, travel: int | None = None, turn: int = 0) -> None:
        """Create the motor of a stage with hard stops beyond its `travel`, or of a rotation with a home in each `turn`.

        Args:
            true_position: true position of the stage from the home sensor's zero [counts].
            count: position that the controller counts.
            travel: length of the travel [counts]; None: unlimited rotation.
            turn: one turn of an unlimited rotation [counts].
        """
        self.time = 0.0
        self.due = math.inf  #: time at which the present segment of the motion ends [s]
        self.acceleration = 1e6  #: [counts/s^2]
        self._lower, self._upper = (-math.inf, math.inf) if travel is None else (-STOPS, travel + STOPS)
        self._turn = turn if travel is None else 0
        self._shift = true_position - count  # true position minus count
        self._stuck: float | None = None
        self._clamped: float | None = None  # count of a clamped stage
        self._plan: deque[Segment] = deque()
        self._start_time, self._start_position, self._start_velocity = 0.0, count, 0.0  # at its start

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [counts]."""
        return self.position + self._shift if self._stuck is None else self._stuck

    @property
    def position(self) -> float:
        """Position that the controller counts."""
        if self._clamped is not None:
            return self._clamped
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

    def zero_behind(self, sensor: float = 0.0) -> float:
        """Return the true position of the zero whose home sensor a backward motion reaches first [counts].

        `sensor` is the distance of a home sensor below its zero [counts].
        """
        return math.floor((self.true_position + sensor) / self._turn) * self._turn if self._turn else 0.0

    def move(self, goal: float, top: float) -> None:
        """Start the fastest motion to rest at the count `goal` with at most the speed `top` [counts/s]."""
        self._begin(quickest_motion(self.position, self.velocity, goal, top, self.acceleration))

    def append(self, start: float, goal: float, top: float) -> None:
        """Append a motion from rest at the count `start` to `goal`; the present motion must end at `start`."""
        self._plan += quickest_motion(start, 0.0, goal, top, self.acceleration)

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
        """Set the count of the present position, and end a motion."""
        self._shift += self.position - count
        self._plan.clear()
        self._start_position, self._start_velocity, self.due = count, 0.0, math.inf

    def arrive(self, count: float) -> None:
        """Place the stage at rest exactly at `count`, without the rounding errors of the motion that ended there."""
        self._start_position = count

    def switch_off_and_on(self) -> None:
        """Stop without a ramp, and set the count of the present position to 0."""
        self.halt()
        self.set_count(0.0)

    def stall(self, stalled: bool) -> None:
        """Start or end a stall, in which the motor turns without moving the stage."""
        if stalled and self._stuck is None:
            self._stuck = self.true_position
        elif not stalled and self._stuck is not None:
            self._shift, self._stuck = self._stuck - self.position, None

    def clamp(self, clamped: bool) -> None:
        """Start or end a clamp, in which stage and count do not move although the controller executes its commands."""
        if clamped and self._clamped is None:
            self._clamped = self.position
        elif not clamped and self._clamped is not None:
            position, velocity, self._clamped = self._clamped, self.velocity, None
            self._start(position, velocity)

    def advance(self, until: float) -> None:
        """Run the motor until the time `until` [s]."""
        while self.due <= until:
            self.time = self.due
            position, velocity = self.position, self.velocity
            self._plan.popleft()
            self._start(position, velocity)
        self.time = until
        true = self.position + self._shift
        if not self._lower <= true <= self._upper:
            self._shift += min(max(true, self._lower), self._upper) - true  # counts lost at a hard stop

    def _begin(self, plan: Sequence[Segment]) -> None:
        position, velocity = self.position, self.velocity
        self._plan = deque(plan)
        self._start(position, velocity)

    def _start(self, position: float, velocity: float) -> None:
        """Start the first segment of the plan."""
        self._start_time, self._start_position, self._start_velocity = self.time, position, velocity
        self.due = self.time + self._plan[0].duration if self._plan else math.inf
