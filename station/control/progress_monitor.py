"""When to give up: the tip does not come nearer and a limit or a singular pose is in the way.

Near a singular pose the joints are damped, at a limit they stop; either may pass by itself, as the
load changes. Only when it lasts, the motion ends in HOLD, with the reason.
"""

import math
from collections import deque

from core.control.inverse import SIGMA_FLOOR
from core.control.step import Tick
from core.robot.limits import Limits

PATIENCE = 5.0  #: without getting nearer [s]
TOLERANCE = 5e-4  #: tip errors below this are no matter [m]
NEARER = 0.9  #: part of its size to which an error has to shrink to count as shrunk
FREE = 0.5  #: without anything in the way for this long, waiting begins anew [s]


class ProgressMonitor:
    """Watches one motion, frame by frame."""

    def __init__(self) -> None:
        self._in_the_way = -math.inf  # when something last was [s]
        self._what = ""  # it was
        self._errors: deque[tuple[float, float]] = deque()  # times and tip errors while it has been

    def look(self, now: float, tick: Tick, limits: Limits, floor: float = SIGMA_FLOOR) -> str:
        """Why the motion should end [one line], or nothing.

        Args:
            now: time [s].
            tick: a tick that followed a setpoint.
            limits: those of its controller.
            floor: smallest singular value from which on nothing is damped [m/s].

        """
        memory = tick.memory
        away = memory.origin + tick.setpoint.position - memory.estimate.observed.tip
        error = math.sqrt(float(away @ away))
        sigma, joints = float(tick.sigma[-1]), memory.estimate.loaded.joints
        blocked = limits.blocking(joints, tick.at_bound, tick.at_row)
        if sigma < floor or blocked:
            self._in_the_way = now
            reasons = [f"singular pose, sigma {1e3 * sigma:.2g} of {1e3 * floor:g} mm/s"] * (sigma < floor)
            self._what = ", ".join((*reasons, *(limits.active(joints, tick.at_bound, tick.at_row) if blocked else ())))
        if error < TOLERANCE or now - self._in_the_way > FREE:
            self._errors.clear()
            return ""
        self._errors.append((now, error))
        begin, before = self._errors[0]
        if now - begin < PATIENCE:
            return ""
        self._errors.popleft()
        if error < NEARER * before:
            return ""
        return (
            f"{self._what}: the tip is {1e3 * error:.2g} mm off and has not come nearer for {PATIENCE:g} s;"
            " move the target or start elsewhere"
        )
