"""The procedures `tracker`, `force` and `tubes`: poses, weights, their order, and the fits to the measurements."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from core.calibration.force import SensorCalibration, WeightCheck, calibrate_sensors, check_weight
from core.calibration.measurements import Measurement
from core.calibration.prediction import Frames, predict
from core.calibration.quantities import quantities
from core.calibration.registration import Registration, register
from core.calibration.residual import PoseErrors, direction_states, fit_residual, paths
from core.calibration.rigid_transform import CoilAxis, coil_axis
from core.calibration.tubes import HeldOutErrors, TubeCalibration, calibrate_tubes, held_out_errors
from core.control.tip_residual import TipResidual
from core.model.batch import Solutions, solve_many
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from core.robot.strength import own_weight
from station.calibration.plan import MEASUREMENT_NOISE, PlanSubject
from station.calibration.poses import DEFAULT_TRAJECTORIES
from station.calibration.procedure import GoToPose, OperatorPrompt, Procedure
from station.config import loads

#: Direction in which a hanging weight pulls, world frame.
GRAVITY = np.array(loads.GRAVITY)
#: Chi square per degree of freedom above which the model does not describe the robot.
SUSPICIOUS_CHI_SQUARE = 9.0
#: Reason that is reported for not using the coil's axis when the model does not describe the robot.
COIL_AXIS_SKIPPED = "the tubes differ from their description, and their different bend looks like a misaligned coil"
#: Standard deviation of the tip's position before and after the calibration of the tubes [m].
UNCALIBRATED_TIP_STD_M, CALIBRATED_TIP_STD_M = 3e-3, 0.1e-3


@dataclass(frozen=True)
class Effort:
    """Number of poses that a procedure visits, and known weights."""

    unloaded: int = 28
    loaded: int = 20  #: number of poses under each weight
    between: int = 8  #: number of poses without load after each weight, which determine the sensors' drift
    check: int = 6  #: number of poses under each weight that check the fits and that no fit uses
    weights: tuple[float, ...] = (0.25, 0.5)  #: known weights that the operator hangs at the tip [N]

    def scaled(self, factor: float) -> "Effort":
        """Return the effort with `factor` times as many poses."""
        return replace(
            self,
            unloaded=round(factor * self.unloaded),
            loaded=round(factor * self.loaded),
            between=max(4, round(factor * self.between)),
            check=max(3, round(factor * self.check)),
        )

    def steps(self) -> int:
        """Number of poses in total."""
        return self.unloaded + len(self.weights) * (self.loaded + self.check + self.between)


class TrackerResult(NamedTuple):
    """Result of the procedure `tracker`."""

    registration: Registration
    measurements: tuple[Measurement, ...]
    axis: CoilAxis | None = None  #: axis of the coil; None: the tracker does not report it


class ForceResult(NamedTuple):
    """Result of the procedure `force`."""

    calibration: SensorCalibration
    checks: tuple[tuple[float, WeightCheck], ...]  #: each known weight [N] with its measurement
    registration: Registration
    measurements: tuple[Measurement, ...]


class TubesResult(NamedTuple):
    """Result of the procedure `tubes`."""

    calibration: TubeCalibration
    sensors: SensorCalibration | None  #: None: the bench has no force sensors
    checks: tuple[tuple[float, WeightCheck], ...]  #: empty without force sensors
    held_out_errors: HeldOutErrors  #: errors at all check measurements, which no fit used
    held_out_loaded: HeldOutErrors
    held_out_believed: Array  #: (k,) errors under load with the frames and tubes assumed before the calibration [m]
    measurements: tuple[Measurement, ...]
    check_measurements: tuple[Measurement, ...]
    axis: CoilAxis | None = None  #: axis of the coil; None: the tracker does not report it
    poses: PoseErrors | None = None  #: remaining errors of the procedure `residual`
    learned: TipResidual | None = None  #: learned residual; None: not requested, or it predicts nothing


def tracker(subject: PlanSubject, effort: Effort) -> Procedure[TrackerResult]:
    """Find the registration of the tracker, and position and axis of the coil, from poses without load.

    Raises:
        UnobservableCombination: the poses inside the limits do not determine the parameters.
        Unreachable: no pose is inside the limits.
    """
    poses, _ = subject.tour((), np.zeros(3), effort.unloaded, None, subject.start)
    measurements: list[Measurement] = []
    for number, joints in enumerate(poses):
        measurement = yield GoToPose(joints, 0.0, number / len(poses))
        measurements += [measurement] if isinstance(measurement, Measurement) else []
    forces = np.zeros((len(measurements), 3))
    found = register(subject.robot, _positions_only(measurements), forces, MEASUREMENT_NOISE, subject.limits)
    axis = _coil_axis(subject.robot, found.frames, measurements, forces)
    if axis is not None and found.fit.variance_factor > SUSPICIOUS_CHI_SQUARE:
        axis = axis._replace(refused=COIL_AXIS_SKIPPED)
    return TrackerResult(found, tuple(measurements), axis)


def force(subject: PlanSubject, effort: Effort) -> Procedure[ForceResult]:
    """Find offsets, drift, mounting and hanging weight of the base sensors; known weights check the result.

    Raises:
        UnobservableCombination: the poses inside the limits do not determine the parameters.
        Unreachable: no pose is inside the limits.
    """
    reduced = replace(effort, unloaded=effort.unloaded // 2, loaded=effort.loaded // 2, check=0)
    measurements, _ = yield from _visits(subject, reduced)
    free = [measurement for measurement in measurements if measurement.weight == 0.0]
    found = register(subject.robot, _positions_only(free), np.zeros((len(free), 3)), MEASUREMENT_NOISE, subject.limits)
    tips = _tips(subject, found.frames, measurements, np.zeros((len(measurements), 3)))
    sensors = calibrate_sensors(subject.robot, measurements, tips, MEASUREMENT_NOISE, UNCALIBRATED_TIP_STD_M)
    return ForceResult(sensors, _weight_checks(subject, sensors, measurements, effort), found, tuple(measurements))


def tubes(subject: PlanSubject, effort: Effort) -> Procedure[TubesResult]:
    """Find sensors, frames and tubes together, from poses without load and under known weights.

    The sensors need the tip's position for the moment equation, and the tubes need the sensors' forces. So the sensors
    are fitted approximately first, then the tubes, then the sensors with the improved tip, and the tubes again. Without
    force sensors the tubes are fitted once, with the known weights as forces.

    Raises:
        UnobservableCombination: the poses inside the limits do not determine the parameters.
        Unreachable: no pose is inside the limits.
    """
    visited, visited_check = yield from _visits(subject, effort)
    measurements, check = _positions_only(visited), _positions_only(visited_check)
    robot = subject.robot
    sags, sensors = _sags(subject, measurements), None
    if subject.senses:
        free = [measurement for measurement in measurements if measurement.weight == 0.0]
        initial = register(robot, free, np.zeros((len(free), 3)), MEASUREMENT_NOISE, subject.limits)
        tips = _tips(subject, initial.frames, measurements, np.zeros((len(measurements), 3)))
        sensors = calibrate_sensors(robot, measurements, tips, MEASUREMENT_NOISE, UNCALIBRATED_TIP_STD_M)
        forces = _forces(subject, sensors, measurements)
        found = calibrate_tubes(robot, measurements, forces, MEASUREMENT_NOISE, sags=sags)
        fitted = replace(subject, robot=found.robot, statics=Statics(found.robot))
        tips = _tips(fitted, found.frames, measurements, forces)
        sensors = calibrate_sensors(robot, measurements, tips, MEASUREMENT_NOISE, CALIBRATED_TIP_STD_M)
    forces = _forces(subject, sensors, measurements)
    found = calibrate_tubes(robot, measurements, forces, MEASUREMENT_NOISE, sags=sags)
    check_forces = _forces(subject, sensors, check)
    if found.rough:
        forces, check_forces = forces + sags, check_forces + _sags(subject, check)
    loaded = np.array([measurement.weight != 0.0 for measurement in check])
    all_, under_load = (
        held_out_errors(
            robot,
            found,
            (measurements, forces),
            ([v for v, w in zip(check, which, strict=True) if w], check_forces[which]),
            MEASUREMENT_NOISE,
        )
        for which in (np.ones(len(check), dtype=bool), loaded)
    )
    heavy = [measurement for measurement, w in zip(check, loaded, strict=True) if w]
    expected = _assumed_model(subject, heavy, check_forces[loaded]).tip
    believed: Array = np.linalg.norm(np.array([measurement.coil for measurement in heavy]) - expected, axis=1)
    checks = () if sensors is None else _weight_checks(subject, sensors, measurements, effort)
    axis = _coil_axis(found.robot, found.frames, visited, forces)
    return TubesResult(found, sensors, checks, all_, under_load, believed, tuple(visited), tuple(visited_check), axis)


def residual(subject: PlanSubject, effort: Effort) -> Procedure[TubesResult]:
    """Find the same as `tubes`, from more poses, and learn the error that remains.

    Raises:
        UnobservableCombination: the poses inside the limits do not determine the parameters.
        Unreachable: no pose is inside the limits.
    """
    found = yield from tubes(subject, replace(effort, check=2 * effort.loaded))
    scattered = list[Measurement]()
    for joints in subject.scattered(np.zeros(3), 3 * effort.unloaded, found.measurements[-1].joints):
        measurement = yield GoToPose(joints, 0.0, 1.0)
        scattered += [measurement] if isinstance(measurement, Measurement) else []
    robot, frames = found.calibration.robot, found.calibration.frames
    fitted = replace(subject, robot=robot, statics=Statics(robot))
    # Sort them in the order of the visits, because the direction states depend on the previous poses.
    measurements = sorted((*found.measurements, *found.check_measurements, *scattered), key=lambda each: each.time)
    # The controller's model does not contain the sag by the tubes' weight, so the residual contains it.
    forces = _forces(fitted, found.sensors, measurements)
    solved, joints = _assumed_model(fitted, measurements, forces), np.array([each.joints for each in measurements])
    coils = frames.registration.apply(np.array([each.coil for each in measurements]))
    errors = coils - solved.rotation @ frames.coil - solved.tip
    blocks = np.arange(len(joints)) * DEFAULT_TRAJECTORIES // len(joints)
    directions = direction_states(fitted.robot, paths(joints))
    poses = PoseErrors(fitted.robot, joints, directions, forces, errors, blocks)
    return found._replace(
        check_measurements=(*found.check_measurements, *scattered), poses=poses, learned=fit_residual(poses)
    )


def _visits(subject: PlanSubject, effort: Effort) -> Procedure[tuple[list[Measurement], list[Measurement]]]:
    """Visit poses without load, then loaded and unloaded poses for each weight; return fit and check measurements."""
    what = quantities(subject.robot)
    total, number, position = effort.steps(), 0, subject.start
    measurements: list[Measurement] = []
    check: list[Measurement] = []

    def rest(poses: Array, weight: float, into: list[Measurement]) -> Procedure[None]:
        nonlocal number, position
        for joints in poses:
            measurement = yield GoToPose(joints, weight, min(number / total, 1.0))
            into += [measurement] if isinstance(measurement, Measurement) else []
            number, position = number + 1, joints

    poses, known = subject.tour(what, np.zeros(3), effort.unloaded, None, position)
    yield from rest(poses, 0.0, measurements)
    for weight in effort.weights:
        pull = weight * GRAVITY
        yield from rest(subject.start[None, :], 0.0, measurements)
        yield OperatorPrompt(f"Hang a weight of {weight:g} N at the tip.", weight, number / total)
        poses, known = subject.tour(what, pull, effort.loaded, known, position)
        yield from rest(poses, weight, measurements)
        if effort.check:
            yield from rest(subject.scattered(pull, effort.check, position), weight, check)
        yield OperatorPrompt("Take the weight off.", 0.0, number / total)
        poses, known = subject.tour(what, np.zeros(3), effort.between, known, position)
        yield from rest(poses, 0.0, measurements)
    return measurements, check


def _positions_only(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Return the measurements without the coil's axis: the model's direction is too inaccurate to fit frames."""
    return [measurement._replace(axes=None) for measurement in measurements]


def _coil_axis(robot: Robot, frames: Frames, measurements: Sequence[Measurement], forces: Array) -> CoilAxis | None:
    """Return the coil's axis in the model's tip frame under forces (m, 3) [N]; None if the tracker reports none."""
    axes = [measurement.axes for measurement in measurements]
    if any(a is None for a in axes):
        return None
    measured = np.array(axes)[:, -1] @ frames.registration.rotation.T
    return coil_axis(predict(robot, measurements, forces).complete().rotation, measured)


def _forces(subject: PlanSubject, sensors: SensorCalibration | None, measurements: Sequence[Measurement]) -> Array:
    """Return tip forces (m, 3) [N]: the known weight, or the measured force where the weight is unknown."""
    return np.array([
        sensors.load(subject.robot, measurement).force
        if sensors is not None and measurement.weight is None
        else (measurement.weight or 0.0) * GRAVITY
        for measurement in measurements
    ])  # fmt: skip


def _sags(subject: PlanSubject, measurements: Sequence[Measurement]) -> Array:
    """Return tip forces (m, 3) [N] that bend the model as the weight of the tubes would bend it.

    Without these forces the fit would explain the sag by rotated frames.
    """
    return np.array([own_weight(subject.robot, measurement.joints) * GRAVITY for measurement in measurements])


def _tips(subject: PlanSubject, frames: Frames, measurements: Sequence[Measurement], forces: Array) -> Array:
    """Return measured tips (m, 3), robot's frame [m]; the coil's offset is subtracted in the model's frame."""
    rotations = _assumed_model(subject, measurements, forces).rotation
    coils = frames.registration.apply(np.array([measurement.coil for measurement in measurements]))
    return coils - rotations @ frames.coil


def _assumed_model(subject: PlanSubject, measurements: Sequence[Measurement], forces: Array) -> Solutions:
    """Return the control model's solutions at measurements under tip forces (m, 3) [N]."""
    joints = np.array([measurement.joints for measurement in measurements])
    return solve_many(subject.statics, joints, np.column_stack((forces, np.zeros_like(forces)))).complete()


def _weight_checks(
    subject: PlanSubject, sensors: SensorCalibration, measurements: Sequence[Measurement], effort: Effort
) -> tuple[tuple[float, WeightCheck], ...]:
    """Return each known weight with its measurement by the calibrated sensors."""
    found: list[tuple[float, WeightCheck]] = []
    for weight in effort.weights:
        measured = np.array(
            [
                sensors.load(subject.robot, measurement).force
                for measurement in measurements
                if measurement.weight == weight
            ]
        )
        found.append((weight, check_weight(measured, weight, GRAVITY)))
    return tuple(found)
