"""Overruns: ticks of the control loop that start too late, and the faults that follow from too many of them.

A tick that starts a period or more after its deadline is an overrun; the loop skips the missed periods and never
catches up. The thresholds are set in the station file.
"""

from collections import deque
from typing import Annotated

from pydantic import Field

from station.config.strict import Strict
from station.devices.interfaces import DeviceFault, Severity

#: Length of the window in which the share of missed periods is counted [s].
OVERRUN_WINDOW_S = 10.0


class OverrunLimits(Strict):
    """Limits of the number of late ticks; too many late ticks end a motion."""

    hold_in_a_row: Annotated[int, Field(ge=1)] = 5
    """number of consecutive overruns that ends a motion in HOLD"""
    hold_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    """largest share of missed periods in 10 s; a motion with a larger share ends in HOLD"""
    fault_in_a_row: Annotated[int, Field(ge=1)] = 20
    """number of consecutive overruns that causes FAULT"""


class Overruns:
    """Counter of the overruns of a control loop whose ticks have the given period [s]."""

    def __init__(self, limits: OverrunLimits, period: float) -> None:
        self._limits = limits
        self._max_missed = limits.hold_share * OVERRUN_WINDOW_S / period
        self._in_a_row = 0
        self._missed = 0
        self._recent: deque[tuple[float, int]] = deque()  # times of overruns [s], and numbers of skipped periods

    def forget(self) -> None:
        """Reset the counts of overruns and missed periods."""
        if self._missed or self._in_a_row:
            self._in_a_row = self._missed = 0
            self._recent.clear()

    def check(self, now: float, skipped: int, slow: str = "") -> DeviceFault | None:
        """Return the fault that follows from a tick at `now` [s] that skipped `skipped` periods; None without a fault.

        `slow` names the custom code that made the tick late; it is empty if no custom code was slow.
        """
        recent = self._recent
        while recent and recent[0][0] <= now - OVERRUN_WINDOW_S:
            self._missed -= recent.popleft()[1]
        if skipped <= 0:
            self._in_a_row = 0
            return None
        self._in_a_row += 1
        self._missed += skipped
        recent.append((now, skipped))
        reason = f"; {slow or 'other programs on this computer use its processors: see ctr-station doctor'}"
        if self._in_a_row >= self._limits.fault_in_a_row:
            return DeviceFault(Severity.FAULT, f"the control loop was late {self._in_a_row} times in a row{reason}")
        if self._in_a_row >= self._limits.hold_in_a_row:
            return DeviceFault(Severity.HOLD, f"the control loop was late {self._in_a_row} times in a row{reason}")
        if self._missed > self._max_missed:
            return DeviceFault(
                Severity.HOLD, f"the control loop has missed {self._missed} periods in {OVERRUN_WINDOW_S:g} s{reason}"
            )
        return None
