"""Ticks that begin too late: counted, and what follows when there are too many.

A tick that begins a period or more after its deadline is an overrun; the periods that it has missed
are skipped, never made up for. The thresholds are the station's.
"""

from collections import deque
from typing import Annotated

from pydantic import Field

from station.config.strict import Strict
from station.devices.interfaces import Severity, Trouble

#: The share of missed periods is counted over this time [s].
WINDOW = 10.0


class OverrunLimits(Strict):
    """How much lateness a motion may suffer."""

    hold_in_a_row: Annotated[int, Field(ge=1)] = 5
    """overruns one after the other that end a motion"""
    hold_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    """of the periods in 10 s missed that ends a motion"""
    fault_in_a_row: Annotated[int, Field(ge=1)] = 20
    """overruns one after the other that make a fault"""


class Overruns:
    """Counts the overruns of a loop with one period [s]."""

    def __init__(self, limits: OverrunLimits, period: float) -> None:
        self._limits = limits
        self._most = limits.hold_share * WINDOW / period
        self._in_a_row = 0
        self._missed = 0
        self._recent: deque[tuple[float, int]] = deque()  # when, and how many periods were skipped

    def forget(self) -> None:
        """Begin to count anew."""
        if self._missed or self._in_a_row:
            self._in_a_row = self._missed = 0
            self._recent.clear()

    def look(self, now: float, skipped: int) -> Trouble | None:
        """What follows from a tick at `now` [s] that has `skipped` so many periods; None if nothing."""
        recent = self._recent
        while recent and recent[0][0] <= now - WINDOW:
            self._missed -= recent.popleft()[1]
        if skipped <= 0:
            self._in_a_row = 0
            return None
        self._in_a_row += 1
        self._missed += skipped
        recent.append((now, skipped))
        said = "; other programs on this computer take its time: see ctr-station doctor"
        if self._in_a_row >= self._limits.fault_in_a_row:
            return Trouble(Severity.FAULT, f"the control loop was late {self._in_a_row} times in a row{said}")
        if self._in_a_row >= self._limits.hold_in_a_row:
            return Trouble(Severity.HOLD, f"the control loop was late {self._in_a_row} times in a row{said}")
        if self._missed > self._most:
            return Trouble(Severity.HOLD, f"the control loop has missed {self._missed} periods in {WINDOW:g} s{said}")
        return None
