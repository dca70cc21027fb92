"""Monitors that end a motion: faults of devices, a snap of the tubes, a stalled or overloaded tip, and late ticks.

A tube that snaps jumps by centimetres, independent of the motors. The loaded model predicts most snaps: its stability
falls to zero. Other snaps appear as a sudden difference between the measured tip and the model's tip. Near a singular
pose the controller damps the joints; at a limit the joints stop. Both may be temporary, because the load changes.
"""

import math
from collections import deque
from collections.abc import Sequence
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from core.control.step import Tick
from core.control.velocity_ik import SIGMA_FLOOR_M_S
from core.errors import DescriptionError
from core.robot.keep_out import region_at
from core.robot.limits import Limits
from core.robot.robot import Array
from core.robot.strength import design_snap_number
from station.config.robots import RobotFile
from station.config.strict import ConfigError, Positive, Strict
from station.control.realtime import load, too_busy
from station.control.states import Transition
from station.devices.interfaces import DeviceFault, Devices, JointReading, Severity, TipReading, WrenchReading

#: Number of consecutive tracker frames that must show the jump of a snap; one frame may be an outlier.
CONFIRMING_FRAMES = 3
#: Time constant [s] of the reference difference between tracker and model, which follows slow changes. A snap takes
#: milliseconds. Sensor drift of 5 mN a minute moves the model's tip by only 0.3 mm in this time.
FORGETS_S = 60.0


class Margins(Strict):
    """Margins against a snap of the tubes."""

    stability: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.1
    """stability of the loaded shape below which a motion ends in HOLD; 1: straight tubes without load, 0: snap"""
    apart: Positive = 0.030
    """change of the tip's difference between tracker and model within a minute; a larger change stops every axis [m]"""
    design: Literal["warn", "refuse"] = "warn"
    """reaction to a robot whose tubes snap somewhere within their travel without load: show a warning, or refuse it"""


#: Number of tracker frames over which the motion of each joint is compared with that of the tip: 2 s at 40 Hz.
LOST_FRAMES = 80
#: Smallest tip motion by one joint in these frames that allows a conclusion about the joint [m].
MIN_JOINT_MOTION_M = 3e-3
#: Largest remainder of the difference between tracker and model that a stationary joint may leave unexplained, as a
#: fraction of the tip motion that the joint should have caused.
MAX_UNEXPLAINED = 0.4


class _Frame(NamedTuple):
    away: Array  #: measured tip minus the model's tip (3,) [m]
    moved: Array  #: sum of the tip motions that the counted motion of each joint causes in the model (3, n) [m]
    joints: Array  #: counted joint positions (n,) [rad or m]


class JointMonitor:
    """Monitor that compares the counted motion of each joint with the tracker.

    A motor without an encoder counts the steps that it should have made. If it loses them, the tip of the model moves
    and the measured tip does not: the difference of both changes by minus the motion that the joint should have caused.
    """

    def __init__(self) -> None:
        self._frames: deque[_Frame] = deque(maxlen=LOST_FRAMES)

    def add(self, joints: Array, jacobian: Array, away: Array) -> None:
        """Add a tracker frame.

        Args:
            joints: counted joint positions (n,) [rad or m].
            jacobian: Jacobian (3, n) of the model's tip.
            away: measured tip minus the model's tip (3,) [m].
        """
        moved = np.zeros_like(jacobian)
        if self._frames:
            moved = self._frames[-1].moved + jacobian * (joints - self._frames[-1].joints)
        self._frames.append(_Frame(away.copy(), moved, joints.copy()))

    def stationary(self) -> int | None:
        """Return the index of the joint that has most probably not moved although it has counted; None if none fits."""
        if not self._frames:
            return None
        away = self._frames[-1].away - self._frames[0].away
        missing = self._frames[0].moved - self._frames[-1].moved
        sizes = np.linalg.norm(missing, axis=0)
        unexplained = np.linalg.norm(away[:, None] - missing, axis=0) / np.maximum(sizes, MIN_JOINT_MOTION_M)
        unexplained[sizes < MIN_JOINT_MOTION_M] = np.inf
        best = int(unexplained.argmin())
        return best if unexplained[best] < MAX_UNEXPLAINED else None


class SnapMonitor:
    """Monitor that checks every tick of one motion for a snap, and names a joint that has lost steps."""

    def __init__(self, margins: Margins, joint_names: Sequence[str]) -> None:
        self._margins, self._joint_names = margins, joint_names
        self._lost = JointMonitor()
        self._reference: Array | None = None  # recent difference of tracker and model (3,) [m]
        self._count = 0
        self._frame_at = 0.0

    def check(self, tick: Tick, frame: bool, now: float) -> DeviceFault | None:
        """Return the fault after a snap at `now` [s], or None; `frame`: whether the tick has a new tracker frame."""
        loaded = tick.memory.estimate.loaded
        if loaded.stability < self._margins.stability:
            return DeviceFault(
                Severity.HOLD,
                f"the tubes are about to snap: stability {loaded.stability:.2g} is below {self._margins.stability:g};"
                " take the load off, or jog the joints back",
            )
        if not frame:
            return None
        away = tick.memory.tip - loaded.tip
        self._lost.add(loaded.joints, loaded.jacobian[:3], away)
        if self._reference is None:
            self._reference, self._frame_at = away, now
        # Drift of the sensors separates tracker and model by millimetres in minutes without a snap.
        part = min((now - self._frame_at) / FORGETS_S, 1.0)
        self._frame_at = now
        change = away - self._reference
        apart = float(np.linalg.norm(change))
        if apart <= self._margins.apart:
            self._reference = self._reference + part * change
        self._count = self._count + 1 if apart > self._margins.apart else 0
        if self._count < CONFIRMING_FRAMES:
            return None
        lost = self._lost.stationary()
        if lost is not None:
            return DeviceFault(
                Severity.STOP,
                f"the joint {self._joint_names[lost]} does not go where it was sent: the tracker shows the tip"
                f" {1e3 * apart:.0f} mm from where the counted joint positions put it (limit"
                f" {1e3 * self._margins.apart:g} mm); free the joint, check its motor, then home it again",
            )
        return DeviceFault(
            Severity.STOP,
            f"the difference of tracker and model has changed by {1e3 * apart:.0f} mm within a minute, more than"
            f" {1e3 * self._margins.apart:g} mm: the tubes may have snapped or touched something, or the field"
            " generator was moved; check before you reset",
        )


def check_design(robot: RobotFile, margins: Margins) -> str:
    """Return a warning if the tubes of a robot snap without load, or if that is unknown; otherwise an empty text.

    Raises:
        ConfigError: the tubes snap, and `margins.design` is "refuse".
    """
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    try:
        number = design_snap_number(robot.robot(), lower, upper)
    except DescriptionError as error:
        return f"{error}, so it cannot be determined in advance whether its tubes snap: watch its stability"
    if number < 1.0:
        return ""
    text = (
        f"robot '{robot.name}': its tubes snap somewhere within their travel (snap number {number:.2f} is not below 1):"
        " choose shorter or straighter tubes, less travel behind the plate, or watch its stability"
    )
    if margins.design == "refuse":
        raise ConfigError(f"{text}; margins.design = 'warn' accepts it")
    return text


STALL_TIME_S = 5.0  #: time without progress of the tip after which a motion ends [s]
MIN_ERROR_M = 5e-4  #: smaller tip errors are ignored [m]
PROGRESS_RATIO = 0.9  #: the tip makes progress if its error is below this fraction of its error `STALL_TIME_S` ago
OVERLOAD_TIME_S = 0.1  #: time with a force above its bound after which the motion ends [s]; noise and a tap are shorter
UNBLOCKED_TIME_S = 0.5  #: time without an active limit or singular pose after which the stall time restarts [s]


class ProgressMonitor:
    """Monitor of one motion; the control loop calls `check` at every tick with a tracker frame.

    A motion ends if the tip makes no progress for `STALL_TIME_S` at a limit or near a singular pose, or if the force on
    the tip exceeds the bound of tubes and sensors (`Limits.overload`) for `OVERLOAD_TIME_S`.
    """

    def __init__(self) -> None:
        self._blocked_at = -math.inf  # last time at a limit or near a singular pose [s]
        self._reason = ""  # description of the limit or singular pose
        self._borne = math.inf  # last time at which the force was below its bound [s]
        self._errors: deque[tuple[float, float]] = deque()  # times [s] and tip errors [m] while a limit is active
        self._through = ""  # text that names the region in which the setpoint was while a limit is active

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
        desired = memory.origin + tick.setpoint.position
        away = desired - memory.estimate.observed.tip
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
            self._through = ""
            return ""
        self._errors.append((now, error))
        if region := region_at(limits.others, desired):
            self._through = f"the path leads through the region '{region}': "
        first, before = self._errors[0]
        if now - first < STALL_TIME_S:
            return ""
        self._errors.popleft()
        if error < PROGRESS_RATIO * before:
            return ""
        return (
            f"{self._through}the tip is {1e3 * error:.2g} mm off and has not come nearer for {STALL_TIME_S:g} s;"
            f" move the target or start elsewhere ({self._reason})"
        )

    def _overload(self, now: float, tick: Tick, limits: Limits) -> str:
        """Return why the force on the tip ends the motion, or an empty text."""
        bound, force = limits.overload, math.hypot(*tick.load.force.tolist())
        if bound is None or not force > bound.newton or self._borne > now:
            self._borne = now
        if bound is None or now - self._borne < OVERLOAD_TIME_S:
            return ""
        return (
            f"the force on the tip {force:.2g} N is above {bound.newton:.2g} N ({bound.reason} bears no more):"
            " take the load off or move the target away; max_force in the robot's file sets another limit"
        )


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
    """Counter of the overruns of a control loop whose ticks have the given period [s].

    An overrun is a tick that starts a period or more after its deadline; the loop skips the missed periods and never
    catches up.
    """

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
        if self._in_a_row >= min(self._limits.fault_in_a_row, self._limits.hold_in_a_row):
            severity = Severity.FAULT if self._in_a_row >= self._limits.fault_in_a_row else Severity.HOLD
            return _overrun(severity, f"the control loop was late {self._in_a_row} times in a row", slow)
        if self._missed > self._max_missed:
            what = f"the control loop missed {self._missed} periods in {OVERRUN_WINDOW_S:g} s"
            return _overrun(Severity.HOLD, what, slow)
        return None


def _overrun(severity: Severity, what: str, slow: str) -> DeviceFault:
    """Return the fault of a late control loop; `slow` names the custom code that delayed it, empty if none did."""
    if slow:
        return DeviceFault(severity, f"custom code is too slow: {what}; {slow}")
    return DeviceFault(severity, too_busy(f"{what}, and all axes were stopped"), load())


#: Transition that a fault of each severity causes.
EVENT_BY_SEVERITY = MappingProxyType(
    {Severity.HOLD: Transition.HOLD, Severity.STOP: Transition.STOP, Severity.FAULT: Transition.FAULT}
)


def device_faults(devices: Devices, now: float) -> tuple[tuple[int, int, int], DeviceFault | None]:
    """Return the severities of stages, tracker and force sensors at `now` [s], and the worst fault.

    The severity is 0 without a fault, and `ABSENT` without the device. Of equal faults the first counts.
    """
    tracker, sensors = devices.tracker, devices.sensors
    of_stages = devices.stages.trouble(now)
    of_tracker = None if tracker is None else tracker.trouble(now)
    of_sensors = None if sensors is None else sensors.trouble(now)
    if of_stages is None and of_tracker is None and of_sensors is None:
        return devices.no_fault, None
    found = of_stages, of_tracker, of_sensors
    first, second, third = (
        none if fault is None else int(fault.severity) for fault, none in zip(found, devices.no_fault, strict=True)
    )
    return (first, second, third), max(filter(None, found), key=lambda fault: fault.severity)


def blocks_motion(trouble: DeviceFault | None) -> bool:
    """Return whether a device's fault forbids motion."""
    return trouble is not None and trouble.severity is not Severity.WARN


def not_finite(joints: JointReading, frame: TipReading | None, wrenches: WrenchReading) -> tuple[str, str]:
    """Return a cause that names the device with a NaN or infinite reading, and the reading; empty if all are finite."""
    readings = (
        ("the stages", joints.positions),
        ("the tracker", None if frame is None else frame.position),
        ("the force sensors", wrenches.wrenches),
    )
    for who, numbers in readings:
        if numbers is not None and not np.isfinite(numbers).all():
            text = f"{who} reported a value that is not finite, and the sample was not used; check the device"
            return text, str(numbers.tolist())
    return "", ""
