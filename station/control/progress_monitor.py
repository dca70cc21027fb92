"""Progress monitor: ends a motion on overload, or when the tip stalls at a limit or a singular pose.

Near a singular pose the controller damps the joints; at a limit the joints stop. Both may be temporary, because the
load changes. If the tip makes no progress for 5 s under such a condition, the motion ends in HOLD with the reason. A
force on the tip above the bound of tubes and sensors (`Limits.overload`) ends the motion after 0.1 s.
"""

import math
from collections import deque

from core.control.step import Tick
from core.control.velocity_ik import SIGMA_FLOOR_M_S
from core.robot.limits import Limits

STALL_TIME_S = 5.0  #: time without progress of the tip after which a motion ends [s]
MIN_ERROR_M = 5e-4  #: smaller tip errors are ignored [m]
PROGRESS_RATIO = 0.9  #: the tip makes progress if its error is below this fraction of its error `STALL_TIME_S` ago
OVERLOAD_TIME_S = 0.1  #: time with a force above its bound after which the motion ends [s]; noise and a tap are shorter
UNBLOCKED_TIME_S = 0.5  #: time without an active limit or singular pose after which the stall time restarts [s]


class ProgressMonitor:
    """Monitor of one motion; the control loop calls `check` at every tick with a tracker frame."""

    def __init__(self) -> None:
        self._blocked_at = -math.inf  # last time at a limit or near a singular pose [s]
        self._reason = ""  # description of the limit or singular pose
        self._borne = math.inf  # last time at which the force was below its bound [s]
        self._errors: deque[tuple[float, float]] = deque()  # times [s] and tip errors [m] while a limit is active

    def check(self, now: float, tick: Tick, limits: Limits, floor: float = SIGMA_FLOOR_M_S) -> str:
        """Return why the motion should end, in one line; empty if it may continue.

        Args:
            now: time [s].
            tick: a tick that followed a setpoint.
            limits: limits of the controller.
            floor: singular value above which the controller does not damp the joints [m/s].

        """
        if overload := self._overload(now, tick, limits):
            return overload
        memory = tick.memory
        away = memory.origin + tick.setpoint.position - memory.estimate.observed.tip
        error = math.sqrt(float(away @ away))
        sigma, joints = float(tick.sigma[-1]), memory.estimate.loaded.joints
        blocked = limits.blocking(joints, tick.at_bound, tick.at_row)
        if sigma < floor or blocked:
            self._blocked_at = now
            reasons = [f"singular pose, sigma {1e3 * sigma:.2g} of {1e3 * floor:g} mm/s"] * (sigma < floor)
            active = limits.active(joints, tick.at_bound, tick.at_row) if blocked else ()
            self._reason = ", ".join((*reasons, *active))
        if error < MIN_ERROR_M or now - self._blocked_at > UNBLOCKED_TIME_S:
            self._errors.clear()
            return ""
        self._errors.append((now, error))
        first, before = self._errors[0]
        if now - first < STALL_TIME_S:
            return ""
        self._errors.popleft()
        if error < PROGRESS_RATIO * before:
            return ""
        return (
            f"{self._reason}: the tip is {1e3 * error:.2g} mm off and has not come nearer for {STALL_TIME_S:g} s;"
            " move the target or start elsewhere"
        )

    def _overload(self, now: float, tick: Tick, limits: Limits) -> str:
        """Return why the force on the tip ends the motion, or an empty text."""
        bound, force = limits.overload, math.hypot(*tick.load.force.tolist())
        if bound is None or not force > bound.newton or self._borne > now:
            self._borne = now
        if bound is None or now - self._borne < OVERLOAD_TIME_S:
            return ""
        return (
            f"force on the tip {force:.2g} N is above {bound.newton:.2g} N ({bound.reason} bears no more):"
            " take the load off or move the target away; max_force in the robot's file sets another limit"
        )
