"""What one who leads the tip says, one message after the other, made into wishes; what makes no sense is refused."""

import math
from collections import deque
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from core.control.leading import BOUNDS, Wish, turns
from core.errors import CtrError
from core.robot.robot import Array
from station.config.controllers import BEST, ControllerFile
from station.config.strict import Strict
from station.control.led import Lead

#: Messages are taken at up to this rate [1/s], with this many at once after a pause.
FASTEST, BURST = 500.0, 100.0
#: The velocity of places is that of the last so many seconds, and of no fewer than so many of them.
WINDOW, FEWEST = 0.1, 3
#: A place is taken to go on by its velocity for so many of the sender's periods, one of which may get lost, but for no
#: shorter and no longer than this: what is late by some milliseconds must not stop a tip [s].
PERIODS, SHORTEST, LONGEST = 2.5, 0.05, 0.2
#: By the sender's own time a message may have been held up for so long on its way [s]; beyond that its clock was set.
HELD_UP = 0.1
#: That the two clocks may go apart [s/s].
DRIFT = 1e-3
#: A direction that is shorter than this is none.
NO_LENGTH = 1e-9


class NotTaken(CtrError):
    """A message that cannot be followed; what was asked for before it stands."""


class TooFast(CtrError):
    """More messages than anybody may send."""


class LeadIn(Strict):
    """What whoever leads the tip agrees to, said once at the beginning."""

    frame: Literal["start", "world"] = "start"
    """places are told from the tip at the start, or in the world"""
    speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """that the tip's setpoint keeps to, whatever is asked for [m/s]"""
    acceleration: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """the same [m/s^2]"""
    turning: Annotated[float, Field(gt=0.0, le=1.0)] = 0.2
    """that the direction in which the tip should point turns at, where the controller's task asks for it [rad/s]"""
    reach: Annotated[float, Field(gt=0.0, le=0.2)] = 0.05
    """places farther from the start tip are refused [m]"""
    silence: Annotated[float, Field(ge=0.05, le=2.0)] = 0.2
    """without a message for this long the tip comes to rest [s]"""
    end: Annotated[float, Field(ge=0.5, le=60.0)] = 2.0
    """and after this long the run ends [s]"""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)] = 600.0
    """that it takes at most [s]"""
    controller: ControllerFile = BEST

    def lead(self) -> Lead:
        """The same for the control loop."""
        bounds = replace(BOUNDS, max_speed=self.speed, max_acceleration=self.acceleration, reach=self.reach)
        return Lead(bounds, self.silence, self.end, turns(self.turning))

    @property
    def points(self) -> bool:
        """Whether the direction of the tip is controlled, so that it may be told."""
        return self.controller.task != "position"


class Leader:
    """One of them, by a clock that tells seconds."""

    def __init__(self, asked: LeadIn, start: Array, now: float) -> None:
        """`start` (3,) is the tip at the start, in the world [m]."""
        self._reach, self._points = asked.reach, asked.points
        self._direction: Array | None = None  # told last
        self._zero = start if asked.frame == "world" else np.zeros(3)
        self._said: deque[tuple[float, Array]] = deque()  # times and places
        self._credit, self._counted = BURST, now
        self._gap, self._last = 0.0, now
        self._behind, self._heard = math.inf, now  # of the sender's clock, with the quickest messages' way [s]

    def count(self, now: float) -> None:
        """A message has come.

        Raises:
            TooFast: they come faster than anybody may send.
        """
        self._credit = min(BURST, self._credit + FASTEST * (now - self._counted)) - 1.0
        self._counted = now
        if self._credit < 0.0:
            raise TooFast(f"more than {FASTEST:g} messages a second; send fewer")

    def place(
        self, told: tuple[float, ...], now: float, sent: float | None = None, direction: tuple[float, ...] | None = None
    ) -> Wish:
        """To be at a place, which goes on as the ones before it did.

        Args:
            told: where [m].
            now: when it has come [s].
            sent: when, by the sender's own clock [s]: what was held up on its way counts as if it had not been.
            direction: in which the tip should point, in the world, of any length but zero; None: the one told last.

        Raises:
            NotTaken: not three finite numbers, beyond the reach, or a direction that cannot be followed.
        """
        pointing = self._pointing(direction)
        place = _vector("tip", told, "m") - self._zero
        away = math.hypot(*place)
        if away > self._reach:
            raise NotTaken(
                f"tip {[round(x, 6) for x in told]} m is {1e3 * away:.4g} mm from the start, beyond the reach of"
                f" {1e3 * self._reach:.4g} mm; the place before it stands"
            )
        self._direction = pointing
        when = self._when(now, sent)
        said, period = self._said, self._period(when)
        if said and when - said[-1][0] > LONGEST:
            said.clear()  # what came before a pause says nothing of now
        said.append((when, place))
        while len(said) > FEWEST and when - said[0][0] > WINDOW:
            said.popleft()
        return Wish(place, _slope(said), when, min(max(PERIODS * period, SHORTEST), LONGEST), pointing)

    def velocity(self, told: tuple[float, ...], now: float) -> Wish:
        """To move at a velocity, and point in the direction told last.

        Raises:
            NotTaken: not three finite numbers.
        """
        self._said.clear()
        self._period(now)
        return Wish(None, _vector("velocity", told, "m/s"), now, math.inf, self._direction)

    def _pointing(self, told: tuple[float, ...] | None) -> Array | None:
        """The unit vector (3,) of a direction, or the one told last."""
        if told is None:
            return self._direction
        if not self._points:
            raise NotTaken(
                "direction: where the tip points is not controlled in this run; begin it with"
                ' controller.task = "position_and_direction", which needs five joints or more; what was asked before it'
                " stands"
            )
        vector = _vector("direction", told, "")
        largest = float(np.abs(vector).max())
        if largest < NO_LENGTH:
            raise NotTaken(
                f"direction {list(told)} has the length {math.hypot(*told):.3g}, shorter than {NO_LENGTH:g}; tell one"
                " of any other length, in the world frame; what was asked before it stands"
            )
        vector /= largest  # the square of what is finite need not be
        return vector / math.hypot(*vector)

    def _when(self, now: float, sent: float | None) -> float:
        """When a message would have come, had it been as quick as the quickest [s]; never before the one before it."""
        if sent is None:
            return now
        behind = now - sent
        self._behind = min(self._behind + DRIFT * (now - self._heard), behind)
        self._heard = now
        if not behind - self._behind <= HELD_UP:
            self._behind = behind
        return max(self._last, now - (behind - self._behind))

    def _period(self, now: float) -> float:
        """Of the sender, smoothed; a pause is none [s]."""
        gap, self._last = now - self._last, now
        if gap < LONGEST:
            self._gap = gap if self._gap == 0.0 else self._gap + 0.1 * (gap - self._gap)
        return min(self._gap, LONGEST)


def _vector(name: str, told: tuple[float, ...], unit: str) -> Array:
    if len(told) != 3 or not all(math.isfinite(x) for x in told):
        said = f"{list(told)} {unit}".rstrip() if len(told) == 3 else f"of {len(told)} numbers"
        raise NotTaken(f"{name} {said}: three finite numbers are needed; what was asked before it stands")
    return np.array(told, dtype=np.float64)


def _slope(said: deque[tuple[float, Array]]) -> Array:
    """Velocity (3,) [m/s] of the line through what was said."""
    times = np.array([time for time, _ in said])
    times -= times.mean()
    spread = float(times @ times)
    if spread == 0.0:
        return np.zeros(3)
    return times @ np.array([place for _, place in said]) / spread
