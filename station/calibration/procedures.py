"""The procedures: which poses, which weights, in which order, and what is made of the measurements."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from core.calibration.coil_axis import CoilAxis, coil_axis
from core.calibration.force import SensorCalibration, WeightCheck, calibrate_sensors, check_weight
from core.calibration.measurements import Measurement
from core.calibration.prediction import Frames, predicted
from core.calibration.quantities import quantities
from core.calibration.registration import Registration, register
from core.calibration.tubes import HeldOut, TubeCalibration, calibrate_tubes, held_out
from core.model.many import Solutions, solve_many
from core.robot.own_weight import own_weight
from core.robot.robot import Array, Robot
from station.calibration.plan import NOISE, Subject
from station.calibration.procedure import Ask, GoTo, Procedure
from station.lab import loads

#: Which way a hung weight pulls, world frame.
GRAVITY = np.array(loads.GRAVITY)
#: Residuals of this many times the noise mean that the model is not the robot.
SUSPICIOUS = 9.0
#: Why the axis of the coil is left alone then.
NOT_TOLD = "the tubes differ from their description, and a tip that bends otherwise looks like a coil askew"
#: How well the tip is known from the tracker before the tubes are calibrated [m], and afterwards.
ROUGH, FINE = 3e-3, 0.1e-3


@dataclass(frozen=True)
class Effort:
    """How many poses are visited."""

    unloaded: int = 28
    loaded: int = 20  #: under each weight
    between: int = 8  #: without load after each weight, for the sensors' drift
    check: int = 6  #: under each weight, held out of every fit
    weights: tuple[float, ...] = (0.25, 0.5)  #: known, to hang at the tip [N]

    def scaled(self, factor: float) -> "Effort":
        """More or fewer poses."""
        return replace(
            self,
            unloaded=round(factor * self.unloaded),
            loaded=round(factor * self.loaded),
            between=max(4, round(factor * self.between)),
            check=max(3, round(factor * self.check)),
        )

    def steps(self) -> int:
        """Poses of the whole."""
        return self.unloaded + len(self.weights) * (self.loaded + self.check + self.between)


class TrackerResult(NamedTuple):
    """What the procedure `tracker` has found."""

    registration: Registration
    measurements: tuple[Measurement, ...]
    axis: CoilAxis | None = None  #: None: the tracker does not tell it


class ForceResult(NamedTuple):
    """What the procedure `force` has found."""

    calibration: SensorCalibration
    checks: tuple[tuple[float, WeightCheck], ...]  #: each known weight, as measured
    registration: Registration
    measurements: tuple[Measurement, ...]


class TubesResult(NamedTuple):
    """What the procedure `tubes` has found."""

    calibration: TubeCalibration
    sensors: SensorCalibration
    checks: tuple[tuple[float, WeightCheck], ...]
    held_out: HeldOut  #: all of the checking measurements
    held_out_loaded: HeldOut
    held_out_believed: Array  #: (k,) errors under load of what the station believed before, frames included [m]
    measurements: tuple[Measurement, ...]
    check_measurements: tuple[Measurement, ...]
    axis: CoilAxis | None = None  #: None: the tracker does not tell it


def tracker(subject: Subject, effort: Effort) -> Procedure[TrackerResult]:
    """Registration of the tracker, place and axis of the coil, from poses without load.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    poses, _ = subject.tour((), np.zeros(3), effort.unloaded, None, subject.start)
    measurements: list[Measurement] = []
    for number, joints in enumerate(poses):
        measurement = yield GoTo(joints, 0.0, number / len(poses))
        measurements += [measurement] if isinstance(measurement, Measurement) else []
    forces = np.zeros((len(measurements), 3))
    found = register(subject.robot, _places(measurements), forces, NOISE, subject.limits)
    axis = _coil_axis(subject.robot, found.frames, measurements, forces)
    if axis is not None and found.fit.variance_factor > SUSPICIOUS:
        axis = axis._replace(refused=NOT_TOLD)
    return TrackerResult(found, tuple(measurements), axis)


def force(subject: Subject, effort: Effort) -> Procedure[ForceResult]:
    """Offsets, drift, mounting and hanging weight of the base sensors; known weights as the check.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    few = replace(effort, unloaded=effort.unloaded // 2, loaded=effort.loaded // 2, check=0)
    measurements, _ = yield from _visits(subject, few)
    free = [measurement for measurement in measurements if measurement.weight == 0.0]
    found = register(subject.robot, _places(free), np.zeros((len(free), 3)), NOISE, subject.limits)
    tips = _tips(subject, found.frames, measurements, np.zeros((len(measurements), 3)))
    sensors = calibrate_sensors(subject.robot, measurements, tips, NOISE, ROUGH)
    return ForceResult(sensors, _checks(subject, sensors, measurements, effort), found, tuple(measurements))


def tubes(subject: Subject, effort: Effort) -> Procedure[TubesResult]:
    """Everything together: sensors, frames and tubes, from poses without load and under known weights.

    The sensors need the tip's place for the moment equation and the tubes the sensors' forces: the sensors are fitted
    roughly first, then the tubes, then the sensors with the tip as it is known now, and the tubes again.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    visited, visited_check = yield from _visits(subject, effort)
    measurements, check = _places(visited), _places(visited_check)
    robot = subject.robot
    free = [measurement for measurement in measurements if measurement.weight == 0.0]
    rough = register(robot, free, np.zeros((len(free), 3)), NOISE, subject.limits)
    tips = _tips(subject, rough.frames, measurements, np.zeros((len(measurements), 3)))
    sensors = calibrate_sensors(robot, measurements, tips, NOISE, ROUGH)
    sags = _sags(subject, measurements)
    found = calibrate_tubes(robot, measurements, _forces(subject, sensors, measurements), NOISE, sags=sags)
    fitted = replace(subject, robot=found.robot)
    tips = _tips(fitted, found.frames, measurements, _forces(subject, sensors, measurements))
    sensors = calibrate_sensors(robot, measurements, tips, NOISE, FINE)
    forces = _forces(subject, sensors, measurements)
    found = calibrate_tubes(robot, measurements, forces, NOISE, sags=sags)
    check_forces = _forces(subject, sensors, check)
    if found.rough:
        forces, check_forces = forces + sags, check_forces + _sags(subject, check)
    loaded = np.array([measurement.weight != 0.0 for measurement in check])
    all_, under_load = (
        held_out(
            robot,
            found,
            (measurements, forces),
            ([v for v, w in zip(check, which, strict=True) if w], check_forces[which]),
            NOISE,
        )
        for which in (np.ones(len(check), dtype=bool), loaded)
    )
    heavy = [measurement for measurement, w in zip(check, loaded, strict=True) if w]
    expected = _believed(subject, heavy, check_forces[loaded]).tip
    believed: Array = np.linalg.norm(np.array([measurement.coil for measurement in heavy]) - expected, axis=1)
    checks = _checks(subject, sensors, measurements, effort)
    axis = _coil_axis(found.robot, found.frames, visited, forces)
    return TubesResult(found, sensors, checks, all_, under_load, believed, tuple(visited), tuple(visited_check), axis)


def _visits(subject: Subject, effort: Effort) -> Procedure[tuple[list[Measurement], list[Measurement]]]:
    """Without load, then under each weight and without again; measurements to fit and measurements to check with."""
    what = quantities(subject.robot)
    total, number, at = effort.steps(), 0, subject.start
    measurements: list[Measurement] = []
    check: list[Measurement] = []

    def rest(poses: Array, weight: float, into: list[Measurement]) -> Procedure[None]:
        nonlocal number, at
        for joints in poses:
            measurement = yield GoTo(joints, weight, min(number / total, 1.0))
            into += [measurement] if isinstance(measurement, Measurement) else []
            number, at = number + 1, joints

    poses, known = subject.tour(what, np.zeros(3), effort.unloaded, None, at)
    yield from rest(poses, 0.0, measurements)
    for weight in effort.weights:
        pull = weight * GRAVITY
        yield from rest(subject.start[None, :], 0.0, measurements)
        yield Ask(f"Hang a weight of {weight:g} N at the tip.", weight, number / total)
        poses, known = subject.tour(what, pull, effort.loaded, known, at)
        yield from rest(poses, weight, measurements)
        if effort.check:
            yield from rest(subject.scattered(pull, effort.check, at), weight, check)
        yield Ask("Take the weight off.", 0.0, number / total)
        poses, known = subject.tour(what, np.zeros(3), effort.between, known, at)
        yield from rest(poses, 0.0, measurements)
    return measurements, check


def _places(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Without the coil's axis: a model's direction is further off than the coil's and must not pull at the frames."""
    return [measurement._replace(axes=None) for measurement in measurements]


def _coil_axis(robot: Robot, frames: Frames, measurements: Sequence[Measurement], forces: Array) -> CoilAxis | None:
    """The coil's axis as the model has the tip under forces (m, 3) [N]; None where the tracker does not tell it."""
    axes = [measurement.axes for measurement in measurements]
    if any(a is None for a in axes):
        return None
    seen = np.array(axes)[:, -1] @ frames.registration.rotation.T
    return coil_axis(predicted(robot, measurements, forces).complete().rotation, seen)


def _forces(subject: Subject, sensors: SensorCalibration, measurements: Sequence[Measurement]) -> Array:
    """Tip forces (m, 3) [N]: what is known to hang there; as measured where nobody knows."""
    return np.array([
        sensors.load(subject.robot, measurement).force if measurement.weight is None else measurement.weight * GRAVITY
        for measurement in measurements
    ])  # fmt: skip


def _sags(subject: Subject, measurements: Sequence[Measurement]) -> Array:
    """Tip forces (m, 3) in place of the tubes' own weight [N]: left out, it would turn the tracker's frame."""
    return np.array([own_weight(subject.robot, measurement.joints) * GRAVITY for measurement in measurements])


def _tips(subject: Subject, frames: Frames, measurements: Sequence[Measurement], forces: Array) -> Array:
    """Measured tips (m, 3), robot's frame [m]; the coil's place is carried back along the model's frame."""
    turns = _believed(subject, measurements, forces).rotation
    coils = frames.registration.apply(np.array([measurement.coil for measurement in measurements]))
    return coils - turns @ frames.coil


def _believed(subject: Subject, measurements: Sequence[Measurement], forces: Array) -> Solutions:
    """The model that controls the robot, at measurements under tip forces (m, 3) [N]."""
    joints = np.array([measurement.joints for measurement in measurements])
    return solve_many(subject.statics, joints, np.column_stack((forces, np.zeros_like(forces)))).complete()


def _checks(
    subject: Subject, sensors: SensorCalibration, measurements: Sequence[Measurement], effort: Effort
) -> tuple[tuple[float, WeightCheck], ...]:
    """Each known weight as the calibrated sensors measure it."""
    found: list[tuple[float, WeightCheck]] = []
    for weight in effort.weights:
        felt = np.array(
            [
                sensors.load(subject.robot, measurement).force
                for measurement in measurements
                if measurement.weight == weight
            ]
        )
        found.append((weight, check_weight(felt, weight, GRAVITY)))
    return tuple(found)
