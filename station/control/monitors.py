"""Monitors that end a motion: faults of devices, snaps, a misplaced tracker, a stalled tip, a large force, late ticks.

A tube that snaps jumps by centimetres, independent of the motors. The loaded model predicts most snaps: it computes
whether tubes that differ from the description would snap before the joints stop. Other snaps appear as a sudden
difference between the measured tip and the model's tip. Near a singular pose the controller damps the joints; at a
limit the joints stop. Both may be temporary, because the load changes.
"""

import math
from collections import deque
from types import MappingProxyType
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from core.control.controller_settings import Controller
from core.control.step import Tick
from core.control.velocity_ik import SIGMA_FLOOR_M_S
from core.errors import DescriptionError
from core.model.fold import margin_of_worst_tubes
from core.model.solution import Solution
from core.robot.keep_out import region_at
from core.robot.limits import ForceBound, Limits
from core.robot.robot import Array
from core.robot.strength import design_snap_number, straightened_strains
from station.config.robots import RobotFile
from station.config.strict import ConfigError, Positive, Strict
from station.control.force_zero import ZERO_AGAIN
from station.control.realtime import load, too_busy
from station.control.states import Transition
from station.devices.interfaces import DeviceFault, Devices, JointReading, Severity, TipReading, WrenchReading

#: Advice to the operator in causes; the page omits it if the virtual lab has already removed its load.
TAKE_OFF = "take the load off, or "
#: Number of consecutive tracker frames that must show the jump of a snap; one frame may be an outlier.
CONFIRMING_FRAMES = 3
#: Time constant [s] of the reference difference between tracker and model, which follows slow changes. A snap takes
#: milliseconds. Sensor drift of 5 mN a minute moves the model's tip by only 0.3 mm in this time.
FORGETS_S = 60.0


class Margins(Strict):
    """Margins against a snap of the tubes."""

    uncertainty: Annotated[float, Field(ge=0.0, le=0.3)] = 0.05
    """relative error of each tube's curvature and stiffness. A motion ends in HOLD as soon as tubes within this error
    would snap before the joints stop. A path to a pose is refused if they would snap on it. 0: the tubes as described
    """
    apart: Positive = 0.030
    """largest change, within a minute, of the tip's difference between tracker and model; a larger change stops every
    axis, and a larger difference at the start ends a motion of the tip [m]"""
    unexplained: Positive = 1.0e-3
    """change of the difference between tracker and model that neither force, pose nor noise explains, above which a
    motion of the tip ends in HOLD; a larger value is for tubes that differ much from the robot's file [m]"""
    design: Literal["warn", "refuse"] = "warn"
    """reaction to a robot whose tubes snap somewhere within their travel without load: show a warning, or refuse it"""


class Window(NamedTuple):
    """Number of tracker frames over which the motion of each joint is compared with that of the tip."""

    frames: int  #: at 40 Hz 20 frames are 0.5 s
    least: float  #: smallest tip motion by one joint that allows a conclusion [m]


WINDOWS = (Window(20, 1.5e-3), Window(40, 2e-3), Window(80, 3e-3))
LOST_FRAMES = max(window.frames for window in WINDOWS)
#: Bounds of the share of a joint's tip motion that is missing if the joint does not move. The share is 1 without noise
#: and changes of the load.
MISSING_SHARE = (0.7, 1.3)
#: Largest remainder of the difference between tracker and model that a stationary joint may leave unexplained during a
#: window, RMS as a fraction of the tip motion that the joint should have caused. In 1.2 h of simulated experiments
#: (116 runs), a limit of 0.4 would have stopped one run by mistake, in the realistic lab, and a limit of 0.3 none.
MAX_UNEXPLAINED = 0.25


class Stationary(NamedTuple):
    """A joint that has not moved although its motor has counted steps."""

    joint: int  #: index of the joint
    missing: float  #: tip motion that it should have caused [m]


class JointMonitor:
    """Monitor that compares the counted motion of each joint with the tracker.

    A motor without an encoder counts the steps that it should have made. If it loses them, the tip of the model moves
    and the measured tip does not: the difference of both changes by minus the motion that the joint should have caused,
    at every frame of a window. A load changes the difference in another way.
    """

    def __init__(self) -> None:
        #: Measured tip minus the model's tip, and sums of the tip motions that the counted motion of each joint causes
        #: in the model (frames, 3, 1 + n) [m].
        self._rows: Array | None = None
        self._count = 0
        self._joints: Array | None = None  # counted joint positions at the last frame (n,) [rad or m]

    def add(self, joints: Array, jacobian: Array, away: Array) -> None:
        """Add a tracker frame.

        Args:
            joints: counted joint positions (n,) [rad or m].
            jacobian: Jacobian (3, n) of the model's tip.
            away: measured tip minus the model's tip (3,) [m].
        """
        if self._rows is None or self._joints is None:
            self._rows, self._joints = np.zeros((LOST_FRAMES + 1, 3, 1 + joints.size)), joints.copy()
        rows = self._rows
        rows[:-1] = rows[1:]
        rows[-1, :, 0] = away
        rows[-1, :, 1:] += jacobian * (joints - self._joints)
        self._joints[:] = joints
        self._count += 1

    def stationary(self) -> Stationary | None:
        """Return the joint that most probably has not moved although its motor has counted steps; None if none fits."""
        best, found = MAX_UNEXPLAINED, None
        for frames, least in WINDOWS:
            if self._rows is None or self._count <= frames:
                break
            last = self._rows[-1 - frames :]
            if (sizes := np.linalg.norm(last[-1, :, 1:] - last[0, :, 1:], axis=0)).max() < least:
                continue
            change = (last - last[0]).reshape(-1, last.shape[2])
            products = change.T @ change  # all sums over the frames; a missing motion counts negatively in them
            along, squares = products[0, 1:], products.diagonal()[1:] + 1e-12
            share = -along / squares
            rest = np.sqrt(np.maximum(products[0, 0] + 2.0 * along + squares, 0.0) / squares)
            rest[(sizes < least) | (share < MISSING_SHARE[0]) | (share > MISSING_SHARE[1])] = np.inf
            joint = int(rest.argmin())
            if rest[joint] < best:
                best, found = float(rest[joint]), Stationary(joint, float(sizes[joint]))
        return found


#: Number of ticks between two checks whether the tubes would snap. A check takes 0.1 ms (two tubes) or 0.25 ms
#: (three).
SNAP_CHECK_TICKS = 10
#: Share of the squared margin at a motion's start; a smaller mean shows that the load has brought the tubes nearer to a
#: snap. Number of checks in this mean, because the force's noise changes the square by a tenth. The square is
#: proportional to the distance from the snap.
LOADED_SHARE, LOADED_CHECKS = 0.7, 10


class SnapAhead:
    """Monitor of one motion that predicts whether the tubes snap before the joints can stop.

    A motion that starts near a snap may lead away from it.
    """

    def __init__(self, margins: Margins, controller: Controller) -> None:
        self._uncertainty, self._statics, self._limits = margins.uncertainty, controller.statics, controller.limits
        self._deceleration = np.array([joint.acceleration for joint in controller.limits.joints])
        delay = controller.estimator.actuation.command_interval + controller.estimator.actuation.transport_delay
        self._delay = delay + (SNAP_CHECK_TICKS + 1) * controller.period
        self._ticks = 0
        self._mean, self._first = math.nan, math.nan  # mean of the squared margin, recently and at the start

    def check(self, loaded: Solution, sent: Array, commanded: Array) -> str:
        """Return why the motion must end, in one line; empty if it may continue.

        Args:
            loaded: present solution of the loaded model.
            sent: joint velocities (n,) that the stages received last [rad/s or m/s].
            commanded: joint velocities (n,) that the controller commands now [rad/s or m/s].
        """
        self._ticks += 1
        if self._ticks % SNAP_CHECK_TICKS != 1:
            return ""
        velocity = np.where(np.abs(sent) > np.abs(commanded), sent, commanded)
        travel = velocity * (self._delay + 0.5 * np.abs(velocity) / self._deceleration)
        lower, upper = self._limits.packed[:2]
        ahead = np.clip(loaded.joints + travel, np.minimum(lower, loaded.joints), np.maximum(upper, loaded.joints))
        if not self._statics.robot.is_valid_pose(ahead):  # the limit of the tubes' order stops the joints earlier
            ahead = loaded.joints.copy()
        described, worst = margin_of_worst_tubes(self._statics, loaded, ahead, self._uncertainty)
        square = loaded.stability**2
        self._mean = square if self._ticks == 1 else self._mean + (square - self._mean) / LOADED_CHECKS
        if self._ticks <= LOADED_CHECKS * SNAP_CHECK_TICKS:
            self._first = self._mean
        if worst > 0.0:
            return ""
        # The control loop solves less accurately, so that its margin cannot be compared with the one ahead.
        now, _ = margin_of_worst_tubes(self._statics, loaded, loaded.joints, 0.0)
        if described >= now and self._mean >= LOADED_SHARE * self._first:
            return ""
        return (
            f"the tubes are about to snap: tubes that differ by {100 * self._uncertainty:g} % from the robot's file may"
            f" snap before the joints stop; {TAKE_OFF}jog the joints back"
        )


class SnapMonitor:
    """Monitor that checks every tick of one motion for a snap, and names a joint that has lost steps."""

    def __init__(self, margins: Margins, controller: Controller, *, knows_force: bool = True) -> None:
        """Prepare the monitor of one motion; `knows_force`: the bench has force sensors, so the model knows the load.

        Without force sensors, joints that compensate a deflection look like joints that do not move.
        """
        self._margins, self._joint_names = margins, controller.statics.robot.joint_names
        self._knows_force, self._ahead = knows_force, SnapAhead(margins, controller)
        self._lost = JointMonitor()
        self._reference: Array | None = None  # recent difference of tracker and model (3,) [m]
        self._count = self._stationary = 0  # frames in a row that show a snap, and a stationary joint
        self._frame_at = 0.0
        self._placed = False  # whether the tracker agreed with the model when the motion of the tip started

    def check(self, tick: Tick, frame: bool, now: float, sent: Array, *, tip: bool = False) -> DeviceFault | None:
        """Return the fault before or after a snap at `now` [s], or with a misplaced tracker; None without a fault.

        Args:
            tick: result of the controller.
            sent: joint velocities (n,) that the stages received last [rad/s or m/s].
            frame: whether the tick has a new tracker frame.
            now: time of the tick [s].
            tip: whether the tick follows a setpoint of the tip, so that the tracker's last frame moves the joints.
        """
        loaded = tick.memory.estimate.loaded
        if cause := self._ahead.check(loaded, sent, tick.command):
            return DeviceFault(Severity.HOLD, cause)
        away = tick.memory.tip - loaded.tip
        # Without force sensors the model does not know the load, but the force from the deflection explains its part.
        deflection = None if self._knows_force else tick.memory.deflection
        unexplained = away if deflection is None else tick.memory.tip - deflection.solution.tip
        if tip and not self._placed and (misplaced := self._misplaced(unexplained)):
            return misplaced
        self._placed |= tip
        if not frame:
            return None
        self._lost.add(loaded.joints, loaded.jacobian[:3], away)
        lost = self._lost.stationary()
        self._stationary = self._stationary + 1 if lost is not None else 0
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
        snapped = self._count >= CONFIRMING_FRAMES
        if lost is not None and (snapped or (self._knows_force and self._stationary >= CONFIRMING_FRAMES)):
            return DeviceFault(
                Severity.STOP,
                f"the joint {self._joint_names[lost.joint]} does not move as commanded: the tracker does not show"
                f" {1e3 * lost.missing:.0f} mm of the tip's motion by this joint; free the joint, check its motor, then"
                " home it again",
            )
        if not snapped:
            return None
        return DeviceFault(
            Severity.STOP,
            f"the difference of tracker and model has changed by {1e3 * apart:.0f} mm within a minute, more than"
            f" {1e3 * self._margins.apart:g} mm: the tubes may have snapped or touched something, or the field"
            " generator was moved; check before you reset",
        )

    def _misplaced(self, away: Array) -> DeviceFault | None:
        """Return a HOLD if the tracker is too far from the model to move the joints; `away` (3,) is the difference [m].

        A tracker that is mounted in another direction than configured, or whose two cameras are exchanged, shows the
        tip elsewhere. The outer loop would move the tip away from its path to correct this.
        """
        distance = float(np.linalg.norm(away))
        if distance <= self._margins.apart:
            return None
        return DeviceFault(
            Severity.HOLD,
            f"the tracker shows the tip {1e3 * distance:.0f} mm from the model's tip (limit"
            f" {1e3 * self._margins.apart:g} mm): check the tracker's mount, the coil, and that its cameras are not"
            " exchanged, then calibrate the tracker; the joints can be jogged meanwhile",
        )


def check_design(robot: RobotFile, margins: Margins) -> str:
    """Return warnings if the tubes of a robot snap without load, if this is unknown, or if the guide overstrains them.

    Raises:
        ConfigError: the tubes snap, and `margins.design` is "refuse".
    """
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    strained = (
        f"robot '{robot.name}': the guide strains tube '{tube.name}' by {100.0 * strain:.2g} %, but its material"
        f" recovers from at most {100.0 * tube.max_strain:g} % (max_strain): choose a thinner or straighter tube, or"
        " less travel behind the plate"
        for tube, strain in zip(robot.tubes, straightened_strains(robot.robot(), lower).tolist(), strict=True)
        if strain > tube.max_strain
    )
    return "; ".join(filter(None, (_check_snap(robot, margins, lower, upper), *strained)))


def _check_snap(robot: RobotFile, margins: Margins, lower: Array, upper: Array) -> str:
    """Return the warning of `check_design` about snaps within the travels `lower` ... `upper` (n,)."""
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
UNBLOCKED_TIME_S = 0.5  #: time without an active limit or singular pose after which the stall time restarts [s]


class ProgressMonitor:
    """Monitor of one motion; the control loop calls `check` at every tick with a tracker frame.

    A motion ends if the tip makes no progress for `STALL_TIME_S` at a limit or near a singular pose.
    """

    def __init__(self) -> None:
        self._blocked_at = -math.inf  # last time at a limit or near a singular pose [s]
        self._reason = ""  # description of the limit or singular pose
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
            f"{self._through}the tip is {1e3 * error:.2g} mm from its setpoint and has not come nearer for"
            f" {STALL_TIME_S:g} s; move the target or start elsewhere ({self._reason})"
        )


#: Time constant of the mean force that is compared with its bound [s]; noise and a tap are shorter.
OVERLOAD_TIME_S = 0.09
#: Rules for jogs above the bound. The force may rise by at most the first value in all jogs, or by the second in each
#: further jog [N]. Within the third value [s] it must fall by the fourth [N]. The rules begin below the bound by the
#: first value: after a HOLD the tip often rests at the bound, and noise alone takes the force above it and back.
RELIEF_RISE_N, FURTHER_RISE_N, RELIEF_TIME_S, RELIEF_FALL_N = 0.05, 0.01, 1.0, 0.02


class ForceMonitor:
    """Monitor of the force on the tip: the only check against the bound of tubes and sensors (`Limits.overload`).

    The control loop calls `update` at every tick with a force, and `check` at every tick that commands the stages.
    Above the bound only a jog may start, because a person must be able to move the tip away. This jog ends if the force
    rises or does not fall. The bound applies to the force plus its largest plausible error.
    """

    def __init__(self) -> None:
        self.force: Array | None = None  #: mean force (3,) of the last `OVERLOAD_TIME_S` [N]; None: unknown
        self._size = 0.0  # size of `force` [N]
        self.possible = 0.0  #: size of `force` plus its largest plausible error [N]
        self._time = 0.0
        self._bound: ForceBound | None = None
        self._relieves = False  # whether the present motion is a jog that started above the bound, or just below it
        self._lowest: float | None = None  # lowest force since the first such jog [N]
        self._lowest_now: float | None = None  # lowest force since the start of the present jog [N]
        self._before: tuple[float, float] | None = None  # time [s] and force [N] from which a jog must lower the force

    def update(self, now: float, force: Array, bound: ForceBound | None, error: float = 0.0) -> None:
        """Update the mean with the total force (3,) [N] of one tick.

        `bound` is the present bound of the force, and `error` the force's largest plausible error [N].
        """
        mean = self.force
        part = 1.0 if mean is None else 1.0 - math.exp(-(now - self._time) / OVERLOAD_TIME_S)
        self.force = force.copy() if mean is None else mean + part * (force - mean)
        self._size, self._time, self._bound = math.hypot(*self.force.tolist()), now, bound
        self.possible = self._size + error
        if not self._exceeds(-RELIEF_RISE_N):
            self._relieves, self._lowest = False, None

    def _exceeds(self, margin: float) -> bool:
        return self.force is not None and self._bound is not None and self.possible > self._bound.newton + margin

    @property
    def _excess(self) -> bool:
        return self._exceeds(0.0)

    @property
    def _is_certain(self) -> bool:
        return self._bound is not None and self._size > self._bound.newton

    def begin(self, *, jog: bool) -> str:
        """Prepare for a motion; return why it must not start, in one line; empty if it may."""
        self._relieves, self._before, self._lowest_now = jog and self._exceeds(-RELIEF_RISE_N), None, None
        return "" if jog or not self._excess else self._text()

    def check(self, now: float) -> str:
        """Return why a motion must end at `now` [s], in one line; empty if it may continue."""
        force = self._size
        if not self._relieves:
            return self._text() if self._excess else ""
        self._before = self._before or (now, force)
        self._lowest = min(force, self._lowest or force)
        self._lowest_now = min(force, self._lowest_now or force)
        if not self._excess:
            return ""
        since, then = self._before
        if force > max(self._lowest + RELIEF_RISE_N, self._lowest_now + FURTHER_RISE_N):
            return self._text()
        if now - since > RELIEF_TIME_S:
            if force > then - RELIEF_FALL_N and self._is_certain:
                return self._text()
            self._before = now, force
        return ""

    def _text(self) -> str:
        assert self._bound is not None, "a force above its bound"  # noqa: S101
        if not self._is_certain:
            return (
                f"the force on the tip, up to {self.possible:.2g} N with the sensors' drift and errors, is above"
                f" {self._bound.newton:.2g} N ({self._bound.reason}); {self._size:.2g} N are measured: {TAKE_OFF}jog"
                f" the tip away; {ZERO_AGAIN}. max_force in the robot's file sets another limit"
            )
        return (
            f"the force on the tip {self._size:.2g} N is above {self._bound.newton:.2g} N"
            f" ({self._bound.reason}): {TAKE_OFF}jog the tip away; only a jog that lowers the force starts."
            " max_force in the robot's file sets another limit"
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

    The severity is 0 without a fault, and `ABSENT` without the device. The first of equally severe faults is returned.
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
