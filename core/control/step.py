"""One tick of the controller, 2 ms at 500 Hz, as a pure function from a sample to an estimate and a command.

    sum the base wrenches -> solve the model with and without load -> estimate deflection, load,
    joints and tip -> outer loop -> inner loop -> inverse inside the limits -> check finite

The tick uses no clock, device or thread. The argument `ControllerState` contains all changing state; the tick returns a
new one.
"""

import math
from typing import NamedTuple

import numpy as np

from core.control.command import OBSERVER_DRIFT, command, joint_command
from core.control.controller_settings import Controller
from core.control.deflection_force import DeflectionForce, start_deflection, update_deflection
from core.control.estimation import FRAME_USED, NO_LOAD, Estimate, perceive
from core.control.force_control import NO_CONTACT, Contact, Press, agility, press, replaced_component, without_component
from core.control.force_error import error_by_deflection, error_by_sensors
from core.control.null_space import StabilityGradient
from core.control.observer import NO_FRAMES, TrackerVelocity, differentiate
from core.control.retreat import NO_RETREAT, RetreatCourse, continued_retreat, within_acceleration
from core.control.sensor_zeros import SensorZeros, start_zeros, update_zeros
from core.control.sensors import FusedLoad, fuse_at
from core.control.shape_correction import ShapeCorrection, start_correction, update_correction
from core.control.stiffness import NO_OFFSET, STAGES_LAG_S, Offset, TipStiffness
from core.control.tip_direction import DirectionEstimate, DirectionTask, start_direction, update_direction
from core.control.tip_force import FITS, MISFIT, QUALITY, SINCE
from core.control.tip_residual import apply_residual
from core.control.trajectories import JointMotion, Setpoint
from core.errors import NotFinite
from core.model.backbone import ExpectedMotion, backbone
from core.model.solution import pure_force
from core.robot.limits import Backbone, Configuration
from core.robot.robot import Array


class Sample(NamedTuple):
    """Readings of the devices at one tick."""

    joints: Array  #: (n,) measured joint positions [rad or m]
    sent: Array  #: (n,) joint velocities sent to the stages last [rad/s or m/s]
    wrenches: Array  #: (s, 6) tared base wrenches, each in its sensor's axes [N, N m]
    tip: Array | None  #: (3,) tip in a new tracker frame [m]; None: no frame arrived since the last tick
    tip_age: float = 0.0  #: time since that tracker frame was measured [s]
    direction: Array | None = None  #: (3,) direction of the tip in the same frame; None: not measured


class ControllerState(NamedTuple):
    """State of the controller that one tick passes to the next."""

    estimate: Estimate
    tip: Array  #: (3,) latest measured tip position [m]
    origin: Array  #: (3,) tip at the start of the motion, to which setpoints are relative [m]
    tracked: TrackerVelocity = NO_FRAMES  #: tip velocity from tracker frames, if the controller differentiates them
    direction: DirectionEstimate | None = None  #: estimate of the tip's direction; None: not estimated
    slope: StabilityGradient | None = None  #: gradient of the stability margin, for redundant joints
    zeros: SensorZeros | None = None  #: drift of the base sensors' zeros since the tare, if it is tracked
    deflection: DeflectionForce | None = None  #: force from the deflection, if there is a tracker
    offset: Offset = NO_OFFSET  #: offset of the setpoint that gives way to the force, if a stiffness is configured
    contact: Contact = NO_CONTACT  #: state of a press, in a motion with a desired force
    correction: ShapeCorrection | None = None  #: correction of the points along the tubes, if there are regions
    retreat: RetreatCourse = NO_RETREAT  #: progress of the present retreat from regions


#: Largest clearance that is recorded [m]; it is also recorded for a robot without regions.
MAX_CLEARANCE_M = 0.1


class Tick(NamedTuple):
    """Result of one tick: the command, the new state, and the quantities that telemetry records."""

    command: Array  #: (n,) commanded joint velocities [rad/s or m/s]
    load: FusedLoad
    u_int: Array  #: (3,) tip velocity requested by the outer loop [m/s]
    setpoint: Setpoint
    sigma: Array  #: singular values of the Jacobian in use times the joints' top speeds [m/s]
    at_bound: Array  #: (n,) -1: joint velocity at its lower bound; 0: free; 1: at its upper bound
    at_row: Array  #: (m,) 1 where a limit of several joints together is active
    memory: ControllerState
    clearance: float = MAX_CLEARANCE_M  #: smallest clearance of the tubes from a region [m]

    @property
    def delta(self) -> Array:
        """(3,) observed tip velocity minus the requested tip velocity U_int, eq. (27) [m/s]."""
        return self.memory.estimate.velocity_observed - self.u_int


def force_error(controller: Controller, memory: ControllerState) -> float:
    """Return the largest plausible error of the force at the tip [N]; 0 while nothing measures the force."""
    if controller.senses:
        return error_by_sensors(memory.estimate.known.load, memory.zeros)
    return 0.0 if memory.deflection is None else error_by_deflection(memory.deflection)


def start_controller(controller: Controller, sample: Sample) -> ControllerState:
    """Return the controller's state before the first tick; with a tracker the sample must contain a frame.

    Raises:
        PoseError, NoSolution, NotFinite: the model cannot start from this sample.

    """
    if controller.tracked and (sample.tip is None or not np.isfinite(sample.tip).all()):
        raise NotFinite(f"measured tip {sample.tip} m: a finite tracker frame is needed to start")
    unloaded = controller.statics.solve(sample.joints, NO_LOAD)
    right = _corrected(controller, sample, unloaded.rotation)
    load = fuse_at(controller.statics.robot, right.joints, right.wrenches)
    loaded = controller.statics.solve(right.joints, pure_force(load.force))
    residual, share = np.zeros(3), 0.0
    if (packed := controller.estimator.residual_packed) is not None:
        still = np.zeros(right.joints.size)
        share = apply_residual(packed, 1.0, still, loaded.numbers, unloaded.numbers, residual)
    tip = loaded.tip.copy() if right.tip is None else right.tip
    zeros = _first_zeros(controller)
    deflection = start_deflection(unloaded, tip - loaded.tip) if controller.tracked else None
    estimate = controller.estimator.start(loaded, unloaded, load.force, tip)
    estimate.known.residual[:], estimate.known.residual_state[:2] = (residual, (share, packed is not None))
    return ControllerState(estimate, tip, tip, zeros=zeros, deflection=deflection)


def set_origin(controller: Controller, memory: ControllerState, origin: Array) -> ControllerState:
    """Return the state for a motion that starts at rest after a tare; its setpoints are relative to `origin` (3,) [m].

    The tare has changed the zero of the force, so the estimates restart without load. The deflection's parts of
    eq. (22) and the force from the deflection restart at zero, too.
    """
    free, direction = memory.estimate.unloaded, memory.direction
    if direction is not None:
        started = start_direction(controller.estimator, free.rotation[:, 2], direction.observed)
        direction = started._replace(measured_once=direction.measured_once)
    estimate, last = controller.estimator.start(free, free, np.zeros(3), origin), memory.estimate.known
    for name in ("directions", "residual", "residual_state"):
        getattr(estimate.known, name)[:] = getattr(last, name)
    zeros = _first_zeros(controller)
    deflection = start_deflection(free, origin - free.tip) if memory.deflection is not None else None
    return memory._replace(estimate=estimate, origin=origin, direction=direction, zeros=zeros, deflection=deflection)


def _first_zeros(controller: Controller) -> SensorZeros | None:
    return start_zeros(len(controller.no_zeros)) if controller.estimator.load.tracks_zeros else None


def handed_over(controller: Controller, memory: ControllerState) -> ControllerState:
    """Return the state with which `controller` continues after another controller of the same bench.

    Zeros that the other controller has estimated stay, so that the force does not change; without them, `controller`
    starts to estimate them.
    """
    estimate = memory.estimate.for_actuation(controller.estimator.actuation)
    return memory._replace(estimate=estimate, zeros=memory.zeros or _first_zeros(controller), slope=None)


def restart_setpoints_here(memory: ControllerState) -> ControllerState:
    """Return the state with the present tip as origin of setpoints and the present direction as start direction."""
    direction = memory.direction
    if direction is not None:
        direction = direction._replace(origin=direction.observed)
    return memory._replace(origin=memory.estimate.observed.tip, direction=direction)


def step(controller: Controller, memory: ControllerState, sample: Sample, order: Setpoint | JointMotion | None) -> Tick:
    """Compute one tick: update the estimates, and compute the joint velocities for `order`.

    The argument `order` is a setpoint to follow, a joint motion to execute, or None to stay at rest.

    Raises:
        PoseError, NoSolution: the model has no shape at the measured pose and load; the distance from a region jumps;
            or a retreat from a region has gone farther than its depth.
        NotFinite: a measurement or the command is not finite; no command of this tick may be sent.

    """
    limits, last = controller.limits, memory.estimate
    if controller.corrections is not None:
        sample = _corrected(controller, sample, last.loaded.rotation)
    zeros = memory.zeros
    load, now = perceive(
        controller.statics, controller.estimator, last,
        sample.joints, sample.wrenches, controller.no_zeros if zeros is None else zeros.values,
        sample.sent, sample.tip, sample.tip_age,
    )  # fmt: skip
    if zeros is not None and sample.tip is not None and controller.estimator.load.tracks_zeros:
        controlled = isinstance(order, Setpoint) and (order.press or controller.stiffness) is not None
        zeros = _updated_zeros(controller, zeros, load, now, controlled=controlled)
    deflection = memory.deflection
    if deflection is not None and sample.tip is not None:
        deflection = update_deflection(
            controller.statics,
            deflection,
            sample.joints,
            now.unloaded,
            now.observed,
            now.known.residual,
            controller.tube_error,
        )
    force = now.force
    if not controller.senses and deflection is not None:
        force = deflection.force
        load = FusedLoad(force, np.zeros(3))
    tip, tracked, drift = memory.tip if sample.tip is None else sample.tip, memory.tracked, OBSERVER_DRIFT
    if not controller.tracked:
        tip = now.loaded.tip
    if controller.differentiates:
        by_joints = now.velocity_observed - now.load_rate - now.drift
        tracked = differentiate(tracked, by_joints, memory.tip, sample.tip, sample.tip_age, controller.period)
        drift = tracked.velocity - now.load_rate
    direction = None
    if controller.aim.lever > 0.0 or controller.watches:
        direction = _direction_estimate(controller, memory.direction, now, sample)
    slope, offset, contact = memory.slope, NO_OFFSET, NO_CONTACT
    near, clearance, correction, retreat = None, MAX_CLEARANCE_M, memory.correction, NO_RETREAT
    if controller.regions:
        correction = _shape_correction(controller, correction, now, sample)
        near = _observed_tubes(controller, correction, now)
        clearance = min(clearance, *(region.smallest_distance(near) for region in controller.regions))
        if isinstance(order, Setpoint):
            retreat = continued_retreat(memory.retreat, clearance, controller.period, controller.regions, near)
    if isinstance(order, Setpoint):
        followed = order
        if controller.stiffness is not None:
            stiffness = order.stiffness or controller.stiffness
            order, followed, offset = _yielding(controller, stiffness, memory, now, force, tip, order)
        if order.press is not None:
            order, followed, contact = _pressing(controller, memory, now, force, tip, order.press, followed)
        tasks, null_space = controller.tasks, None
        if direction is not None and controller.aim.lever > 0.0:
            tasks = (*tasks, DirectionTask(controller.aim.lever, direction, order.direction, order.turning))
        if controller.null_space is not None:
            slope = controller.null_space.updated_gradient(controller.statics, limits, now.loaded, slope)
            null_space = controller.null_space.objective(
                limits, controller.kinks, sample.joints, now.loaded.stability, slope
            )
        found = command(
            controller.strategy, controller.feedback, limits,
            sample.joints, now, force, followed, tip, memory.origin, drift,
            controller.aim, tasks, null_space, near,
        )  # fmt: skip
        if near is not None:
            at = Configuration(sample.joints, now.loaded.jacobian[:3], now.observed.tip, force, near)
            interval = max(controller.estimator.actuation.command_interval, controller.period)
            velocity = within_acceleration(limits, at, sample.sent, found.velocity, interval)
            found = found._replace(velocity=velocity)
    else:
        # Without a tip setpoint, report the present tip as setpoint.
        velocity = np.zeros(sample.joints.size) if order is None else order.velocity
        found = joint_command(limits, sample.joints, now, force, velocity, near)
        order = Setpoint(tip - memory.origin, np.zeros(3))
    finite = sample.tip is None or all(map(math.isfinite, tip.tolist()))  # earlier frames were checked in earlier ticks
    if not (finite and all(map(math.isfinite, found.velocity.tolist()))):
        raise NotFinite(
            f"joint velocities {found.velocity.tolist()} at measured tip {tip.tolist()} m are not finite"
        )  # fmt: skip
    return Tick(
        found.velocity, load, found.u_int, order, found.sigma, found.at_bound, found.at_row,
        ControllerState(
            now, tip, memory.origin, tracked, direction, slope, zeros, deflection, offset, contact, correction,
            retreat,
        ),
        clearance,
    )  # fmt: skip


def _shape_correction(
    controller: Controller, last: ShapeCorrection | None, now: Estimate, sample: Sample
) -> ShapeCorrection:
    """Return the correction of the points along the tubes; every tracker frame updates this correction."""
    statics, causes, noise = controller.statics, controller.error_causes, controller.estimator.observer.noise
    if last is None:
        return start_correction(statics, causes, now.loaded, noise)
    return last if sample.tip is None else update_correction(statics, causes, last, now.loaded, noise)


def _observed_tubes(controller: Controller, correction: ShapeCorrection, now: Estimate) -> Backbone:
    """Return the points of the tubes, bent to the observed tip, and their motion until a command takes effect."""
    known, lead_time = now.known, controller.estimator.actuation.lead_time + STAGES_LAG_S
    expected = ExpectedMotion(known.ahead, known.force_rate, known.drift, lead_time)
    # `backbone` moves the model's points by `tip` minus the solved tip. Only the solved tip contains the residual.
    tip = now.observed.tip + known.residual
    return backbone(controller.statics, now.loaded, tip, expected, correction.weights)


def _pressing(
    controller: Controller, memory: ControllerState, now: Estimate, force: Array, tip: Array, desired: Press,
    order: Setpoint,
) -> tuple[Setpoint, Setpoint, Contact]:  # fmt: skip
    """Return the setpoint to record (no error along the press), the setpoint for the loops, and the press's state.

    The loops multiply the remaining distance by k1 and subtract the motion of the tip that the joints do not cause. The
    setpoint for the loops compensates both, so that the joints alone move the tip with the velocity of the press.
    """
    along, gain = desired.direction, controller.strategy.gain
    here = (now.tip_ahead if controller.feedback.observes else tip) - memory.origin
    at = now.observed.tip - memory.origin
    _, _, speeds, accelerations, *_ = controller.limits.packed
    contact = press(
        desired, memory.contact, force, now.loaded.compliance[:3, :3], float(along @ at),
        agility(now.loaded.jacobian[:3], speeds, accelerations, along), gain,
        controller.force_delay, controller.period,
    )  # fmt: skip
    not_by_joints = float(along @ now.load_rate + along @ now.drift)
    across = without_component(order.velocity, along)
    aim = replaced_component(order.position, along, float(along @ here) + (contact.velocity + not_by_joints) / gain)
    shown = replaced_component(order.position, along, float(along @ at))
    return order._replace(position=shown, velocity=across), order._replace(position=aim, velocity=across), contact


def _yielding(
    controller: Controller, stiffness: TipStiffness, memory: ControllerState, now: Estimate, force: Array, tip: Array,
    order: Setpoint,
) -> tuple[Setpoint, Setpoint, Offset]:  # fmt: skip
    """Return the setpoint that gives way to the force, the setpoint for the loops, and the offset of both.

    The loops multiply the remaining distance by k1. Where contact needs a smaller gain, their setpoint is nearer.
    """
    feedback, gain = controller.feedback, controller.strategy.gain
    rotation = now.loaded.rotation
    rates = stiffness.rates(now.loaded.compliance[:3, :3], rotation, gain, controller.force_delay)
    offset = stiffness.update(memory.offset, force, rotation, rates, controller.period)
    order = order._replace(
        position=order.position + offset.position, velocity=order.velocity + offset.velocity, stiffness=stiffness
    )
    here = (now.tip_ahead if feedback.observes else tip) - memory.origin
    ahead = feedback.lead_time * order.velocity
    nearer = here + rates.gain @ (order.position + ahead - here) / gain - ahead
    return order, order._replace(position=nearer), offset


def _updated_zeros(
    controller: Controller, last: SensorZeros, load: FusedLoad, now: Estimate, *, controlled: bool
) -> SensorZeros:
    """Return the sensors' zeros after a tracker frame; a frame that the observer rejects leaves them unchanged.

    `controlled`: the motion controls the force.
    """
    known = now.known
    if not now.numbers[FRAME_USED]:
        return last
    total = np.concatenate((load.force, load.moment))
    misfit, since = float(known.load[QUALITY, MISFIT]) / FITS, float(known.load[QUALITY, SINCE])
    return update_zeros(
        last, controller.estimator.load.errors, controller.statics.robot, now.loaded,
        total, known.bias, known.force_smooth, misfit, since, controlled=controlled,
    )  # fmt: skip


def _direction_estimate(
    controller: Controller, last: DirectionEstimate | None, now: Estimate, sample: Sample
) -> DirectionEstimate:
    """Return the estimate of the tip's direction in this tick; the first call starts the estimate."""
    if last is None:
        axis = now.loaded.rotation[:, 2]
        direction = axis if sample.direction is None else sample.direction
        direction = start_direction(controller.estimator, axis, direction)
        return direction._replace(measured_once=sample.direction is not None)
    return update_direction(controller.estimator, last, now, now.force, sample.direction, sample.tip_age)


def _corrected(controller: Controller, sample: Sample, rotation: Array) -> Sample:
    """Return the sample with the calibration's corrections; `rotation` (3, 3) is the latest frame of the tip."""
    corrections = controller.corrections
    if corrections is None:
        return sample
    tip = None if sample.tip is None else corrections.tip(sample.tip, rotation)
    direction = None if sample.direction is None else corrections.direction(sample.direction, rotation)
    wrenches = corrections.sensors.exerted(controller.statics.robot, sample.joints, sample.wrenches)
    return sample._replace(wrenches=wrenches, tip=tip, direction=direction)
