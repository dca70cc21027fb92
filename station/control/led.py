"""A tip that is led from outside while a run is on: how long one may be silent, and when it ends."""

from dataclasses import dataclass
from typing import NamedTuple

from core.control.leading import BOUNDS, TURNS, LedTip, Wish
from core.control.pursuit import Pursuit
from core.control.trajectories import Setpoint
from core.robot.robot import Array

#: A tip that moves and turns slower than this is at rest [m/s], [rad/s].
AT_REST, POINTS_STILL = 1e-4, 1e-3


class Asked(NamedTuple):
    """What the one who leads the tip of a run has asked for last."""

    run: int
    wish: Wish | None  #: None: they have left


@dataclass(frozen=True)
class Lead:
    """What whoever leads agrees to at the start; takes the place of orders that are known beforehand."""

    bounds: Pursuit = BOUNDS
    silence: float = 0.2  #: without a word for this long the tip comes to rest [s]
    end: float = 2.0  #: and after this long the motion ends [s]
    turning: Pursuit = TURNS  #: bounds of the wanted direction, of angles


class LedMotion:
    """One such motion, from its start."""

    def __init__(self, lead: Lead, start: float, period: float, pointing: Array | None = None) -> None:
        """It begins at `start` [s]; a tick takes a `period` [s]; `pointing` (3,) as of `LedTip`."""
        self._lead, self._tip, self._period = lead, LedTip(lead.bounds, lead.turning, pointing), period
        self._heard = start  # the last word, or the start [s]

    def order(self, now: float, blind: float, asked: Asked | None) -> Setpoint | None:
        """What this tick has to do; None once the motion has ended.

        Args:
            now: time [s].
            blind: how long the tip has not been measured, so that it is not led on [s].
            asked: what was asked for last, None before that; whoever has left lets the tip come to rest, then it ends.
        """
        wish = None if asked is None else asked.wish
        if wish is not None:
            self._heard = max(self._heard, wish.asked)
        silent = now - self._heard
        rests = self._tip.speed < AT_REST and self._tip.turning < POINTS_STILL
        if (asked is not None and wish is None and rests) or silent > self._lead.end:
            return None
        return self._tip.advance(now, None if blind > 0.0 or silent > self._lead.silence else wish, self._period)
