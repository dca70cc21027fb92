"""One tick of the controller, 2 ms at 500 Hz, as a pure function: sample -> estimate -> command.

    fuse the base wrenches -> solve the loaded and the unloaded model -> estimate deflection, load,
    joints and tip -> outer loop -> inner loop -> inverse inside the limits -> check finite

No clock, no device, no thread: everything that changes goes in as `ControllerState` and comes out anew.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.control.command import OBSERVED, Commanded, Looks, command
from core.control.controllers import Strategy
from core.control.corrections import Corrections
from core.control.differentiated import AT_REST, Differentiated, differentiate
from core.control.estimation import Estimate, Estimator
from core.control.force_fusion import Fused, fuse_at
from core.control.inverse import NO_ROOM
from core.control.perception import perceive
from core.control.pointing import NOT_ASKED, PLACE, Aim, Pointed, look, told
from core.control.pointing import start as begin_to_point
from core.control.spare import Slope, Spare
from core.control.trajectories import JointMotion, Setpoint
from core.errors import DescriptionError, NotFinite
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array


class Sample(NamedTuple):
    """What the devices say at one tick."""

    joints: Array  #: (n,) measured [rad or m]
    sent: Array  #: (n,) velocities that went out to the stages last [rad/s or m/s]
    wrenches: Array  #: (q, 6) tared base wrenches, each in its sensor's axes [N, N m]
    tip: Array | None  #: (3,) a new tracker frame [m]; None when none arrived since the last tick
    tip_age: float = 0.0  #: time since that frame was measured [s]
    direction: Array | None = None  #: (3,) of the tip, of the same frame; None: not told


class ControllerState(NamedTuple):
    """All that one tick leaves to the next."""

    estimate: Estimate
    tip: Array  #: (3,) latest measured tip [m]
    origin: Array  #: (3,) tip at the start, where setpoints count from [m]
    seen: Differentiated = AT_REST  #: what frames show, where the controller looks at them so
    pointed: Pointed | None = None  #: what is known of the tip's direction, where that is controlled
    slope: Slope | None = None  #: of the margin of stability, where joints that are left over look after it


class Tick(NamedTuple):
    """Result of one tick: the command and everything worth plotting."""

    command: Array  #: (n,) joint velocities [rad/s or m/s]
    load: Fused
    u_int: Array  #: (3,) what the outer loop asked for [m/s]
    setpoint: Setpoint
    sigma: Array  #: singular values of the Jacobian in use, joints in units of top speed [m/s]
    at_bound: Array  #: (n,) -1, 0, 1: joint held at its lower bound, free, at its upper
    at_row: Array  #: (m,) 1 where a limit beyond single joints is active
    memory: ControllerState

    @property
    def delta(self) -> Array:
        """(3,) mismatch of the tip's velocity, eq. (27): observed - U_int [m/s]."""
        return self.memory.estimate.known.velocity_observed - self.u_int


@dataclass(frozen=True)
class Controller:
    """What stays the same from tick to tick."""

    statics: Statics
    strategy: Strategy
    limits: Limits
    estimator: Estimator
    #: The outer loop looks at the observed tip of the moment when its command takes effect; without,
    #: at the latest tracker frame as it is (the paper).
    observes: bool = False
    #: Type I takes the deflection's rate from C, J and the filtered force; without, from the
    #: filtered numerical derivative (the paper).
    exact_rate: bool = False
    #: Type II takes the tip's velocity from the tracker's frames, differentiated (the paper); without,
    #: from the observer.
    differentiates: bool = False
    #: From a calibration; without, the coil is at the tip and the sensors stand as their tubes.
    corrections: Corrections | None = None
    #: What of the tip is controlled.
    aim: Aim = PLACE
    #: What joints that are left over do; without, nothing.
    spare: Spare | None = None
    #: The direction is looked at although it is not controlled: for a calibration.
    watches: bool = False

    def __post_init__(self) -> None:
        n = len(self.limits.joints)
        if self.aim.lever > 0.0 and self.strategy.laws is None:
            raise DescriptionError("loops of one's own control the tip's place: its direction is not theirs to ask for")
        if self.aim.lever > 0.0 and self.aim.rows > n:
            raise DescriptionError(f"task: {self.aim.rows} numbers are asked of the tip, and there are {n} joints")

    @property
    def period(self) -> float:
        """Time between ticks [s]."""
        return self.estimator.filter.period

    @cached_property
    def looks(self) -> Looks:
        """What the loops look at."""
        return Looks(self.estimator.actuation.lead if self.observes else 0.0, self.observes, self.exact_rate)

    def tare(self, readings: Array, joints: Array) -> Array:
        """Zero of the base sensors (q, 6) from readings (q, 6) without load at joints (n,)."""
        if self.corrections is None:
            return readings
        return self.corrections.offset(readings, self.statics.robot.tube_poses(joints)[0])

    def tip(self, measured: Array, memory: "ControllerState") -> Array:
        """The tip (3,) of a tracker frame (3,) [m]."""
        if self.corrections is None:
            return measured
        return self.corrections.tip(measured, memory.estimate.loaded.rotation)


def begin(controller: Controller, sample: Sample) -> ControllerState:
    """State before the first tick; the first sample must carry a tracker frame.

    Raises:
        PoseError, NoSolution, NotFinite: the model cannot start from this sample.

    """
    if sample.tip is None or not np.isfinite(sample.tip).all():
        raise NotFinite(f"measured tip {sample.tip} m: a finite tracker frame is needed to begin")
    unloaded = controller.statics.solve(sample.joints, _NO_LOAD)
    right = _corrected(controller, sample, unloaded.rotation)
    load = fuse_at(controller.statics.robot, right.joints, right.wrenches)
    loaded = controller.statics.solve(right.joints, pure_force(load.force))
    tip = sample.tip if right.tip is None else right.tip
    return ControllerState(controller.estimator.start(loaded, unloaded, load.force, tip), tip, tip)


def set_origin(controller: Controller, memory: ControllerState, origin: Array) -> ControllerState:
    """Start a motion here, at rest and just tared: setpoints count from `origin` (3,) [m], eq. (22) from zero.

    The tare has moved the zero of the force, so the estimates begin anew without load.
    """
    free, pointed = memory.estimate.unloaded, memory.pointed
    if pointed is not None:
        seen = pointed.seen
        pointed = begin_to_point(controller.estimator, free.rotation[:, 2], pointed.observed)._replace(seen=seen)
    estimate = controller.estimator.start(free, free, np.zeros(3), origin)
    return memory._replace(estimate=estimate, origin=origin, pointed=pointed)


def from_here(memory: ControllerState) -> ControllerState:
    """Setpoints count from where the tip is, and "keep it" is where it points now."""
    pointed = memory.pointed
    if pointed is not None:
        pointed = pointed._replace(origin=pointed.observed)
    return memory._replace(origin=memory.estimate.observed.tip, pointed=pointed)


def step(controller: Controller, memory: ControllerState, sample: Sample, order: Setpoint | JointMotion | None) -> Tick:
    """One period: follow a setpoint, move joints as told, or (None) stand still; the estimates always go on.

    Raises:
        PoseError, NoSolution: the model cannot follow the measured pose and load.
        NotFinite: a measurement or the command is not finite; nothing of this tick may be sent.

    """
    limits, last = controller.limits, memory.estimate
    if controller.corrections is not None:
        sample = _corrected(controller, sample, last.loaded.rotation)
    load, now = perceive(
        controller.statics, controller.estimator, last,
        sample.joints, sample.wrenches, sample.sent, sample.tip, sample.tip_age,
    )  # fmt: skip
    tip, seen, drift = memory.tip if sample.tip is None else sample.tip, memory.seen, OBSERVED
    if controller.differentiates:
        known = now.known
        by_joints = known.velocity_observed - known.load_rate - known.drift
        seen = differentiate(seen, by_joints, memory.tip, sample.tip, sample.tip_age, controller.period)
        drift = seen.velocity - known.load_rate
    pointed = None
    if controller.aim.lever > 0.0 or controller.watches:
        pointed = _pointing(controller, memory.pointed, now, load.force, sample)
    slope = memory.slope
    if isinstance(order, Setpoint):
        asked, spare = NOT_ASKED, None
        if pointed is not None and controller.aim.lever > 0.0:
            asked = told(pointed, order.direction, order.turning, controller.observes)
        if controller.spare is not None:
            slope = controller.spare.tried(controller.statics, limits, now.loaded, slope)
            spare = controller.spare.velocity(limits, sample.joints, now.loaded.stability, slope)
        found = command(
            controller.strategy, controller.looks, limits,
            sample.joints, now, load.force, order, tip, memory.origin, drift,
            controller.aim, asked, spare,
        )  # fmt: skip
    else:
        # Nothing is asked of the tip: it is where it should be.
        velocity = np.zeros(sample.joints.size) if order is None else order.velocity
        found, order = _as_told(limits, sample.joints, velocity), Setpoint(tip - memory.origin, np.zeros(3))
    finite = sample.tip is None or all(map(math.isfinite, tip.tolist()))  # an older one has been looked at
    if not (finite and all(map(math.isfinite, found.velocity.tolist()))):
        raise NotFinite(
            f"joint velocities {found.velocity.tolist()} at measured tip {tip.tolist()} m are not finite"
        )  # fmt: skip
    return Tick(
        found.velocity, load, found.u_int, order, found.sigma, found.at_bound, found.at_row,
        ControllerState(now, tip, memory.origin, seen, pointed, slope),
    )  # fmt: skip


def _pointing(controller: Controller, last: Pointed | None, now: Estimate, force: Array, sample: Sample) -> Pointed:
    """What is known of the tip's direction, from the first frame on."""
    if last is None:
        axis = now.loaded.rotation[:, 2]
        direction = axis if sample.direction is None else sample.direction
        pointed = begin_to_point(controller.estimator, axis, direction)
        return pointed._replace(seen=sample.direction is not None)
    return look(controller.estimator, last, now, force, sample.direction, sample.tip_age)


def _as_told(limits: Limits, joints: Array, asked: Array) -> Commanded:
    """Joints at (n,) that move as asked (n,) [rad/s or m/s], as far as they can stop inside their travel."""
    lower, upper = limits.velocity_bounds(joints)
    velocity = np.minimum(np.maximum(asked, lower), upper)
    return Commanded(velocity, np.zeros(3), np.zeros(min(3, asked.size)), np.sign(asked - velocity), NO_ROOM)


def _corrected(controller: Controller, sample: Sample, rotation: Array) -> Sample:
    """The sample as calibrated devices would have given it; `rotation` (3, 3) is the tip's frame of just now."""
    corrections = controller.corrections
    if corrections is None:
        return sample
    alpha, _ = controller.statics.robot.tube_poses(sample.joints)
    tip = None if sample.tip is None else corrections.tip(sample.tip, rotation)
    direction = None if sample.direction is None else corrections.direction(sample.direction, rotation)
    return sample._replace(wrenches=corrections.wrenches(sample.wrenches, alpha), tip=tip, direction=direction)


_NO_LOAD = np.zeros(6)
