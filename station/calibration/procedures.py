"""The procedures: which poses, which weights, in which order, and what is made of the visits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from core.calibration.force import SensorCalibration, WeightCheck, calibrate_sensors, check_weight
from core.calibration.prediction import Frames
from core.calibration.quantities import quantities
from core.calibration.registration import Registration, register
from core.calibration.tubes import HeldOut, TubeCalibration, calibrate_tubes, held_out
from core.calibration.visits import Visit
from core.robot.robot import Array
from station.calibration.plan import NOISE, Subject
from station.calibration.procedure import Ask, GoTo, Procedure
from station.lab import loads

#: Which way a hung weight pulls, world frame.
GRAVITY = np.array(loads.GRAVITY)
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
    visits: tuple[Visit, ...]


class ForceResult(NamedTuple):
    """What the procedure `force` has found."""

    calibration: SensorCalibration
    checks: tuple[tuple[float, WeightCheck], ...]  #: each known weight, as measured
    registration: Registration
    visits: tuple[Visit, ...]


class TubesResult(NamedTuple):
    """What the procedure `tubes` has found."""

    calibration: TubeCalibration
    sensors: SensorCalibration
    checks: tuple[tuple[float, WeightCheck], ...]
    held_out: HeldOut  #: all of the checking visits
    held_out_loaded: HeldOut
    held_out_believed: Array  #: (k,) errors under load of what the station believed before, frames included [m]
    visits: tuple[Visit, ...]
    check_visits: tuple[Visit, ...]


def tracker(subject: Subject, effort: Effort) -> Procedure[TrackerResult]:
    """Registration of the tracker and place of the coil, from poses without load.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    poses, _ = subject.tour((), np.zeros(3), effort.unloaded, None, subject.start)
    visits: list[Visit] = []
    for number, joints in enumerate(poses):
        visit = yield GoTo(joints, 0.0, number / len(poses))
        visits += [visit] if isinstance(visit, Visit) else []
    found = register(subject.robot, visits, np.zeros((len(visits), 3)), NOISE, subject.limits)
    return TrackerResult(found, tuple(visits))


def force(subject: Subject, effort: Effort) -> Procedure[ForceResult]:
    """Offsets, drift, mounting and hanging weight of the base sensors; known weights as the check.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    few = replace(effort, unloaded=effort.unloaded // 2, loaded=effort.loaded // 2, check=0)
    visits, _ = yield from _visits(subject, few)
    free = [visit for visit in visits if visit.weight == 0.0]
    found = register(subject.robot, free, np.zeros((len(free), 3)), NOISE, subject.limits)
    tips = _tips(subject, found.frames, visits, np.zeros((len(visits), 3)))
    sensors = calibrate_sensors(subject.robot, visits, tips, NOISE, ROUGH)
    return ForceResult(sensors, _checks(subject, sensors, visits, effort), found, tuple(visits))


def tubes(subject: Subject, effort: Effort) -> Procedure[TubesResult]:
    """Everything together: sensors, frames and tubes, from poses without load and under known weights.

    The sensors need the tip's place for the moment equation and the tubes the sensors' forces: the sensors are fitted
    roughly first, then the tubes, then the sensors with the tip as it is known now, and the tubes again.

    Raises:
        Unobservable: the poses inside the limits cannot tell.
        Unreachable: there are none.
    """
    visits, check = yield from _visits(subject, effort)
    robot = subject.robot
    free = [visit for visit in visits if visit.weight == 0.0]
    rough = register(robot, free, np.zeros((len(free), 3)), NOISE, subject.limits)
    tips = _tips(subject, rough.frames, visits, np.zeros((len(visits), 3)))
    sensors = calibrate_sensors(robot, visits, tips, NOISE, ROUGH)
    found = calibrate_tubes(robot, visits, _forces(subject, sensors, visits), NOISE)
    fitted = replace(subject, robot=found.robot)
    tips = _tips(fitted, found.frames, visits, _forces(subject, sensors, visits))
    sensors = calibrate_sensors(robot, visits, tips, NOISE, FINE)
    forces = _forces(subject, sensors, visits)
    found = calibrate_tubes(robot, visits, forces, NOISE)
    check_forces = _forces(subject, sensors, check)
    loaded = np.array([visit.weight != 0.0 for visit in check])
    all_, under_load = (
        held_out(
            robot,
            found,
            (visits, forces),
            ([v for v, w in zip(check, which, strict=True) if w], check_forces[which]),
            NOISE,
        )
        for which in (np.ones(len(check), dtype=bool), loaded)
    )
    heavy = [visit for visit, w in zip(check, loaded, strict=True) if w]
    expected = [
        subject.statics.solve(visit.joints, np.concatenate((force_, np.zeros(3)))).tip
        for visit, force_ in zip(heavy, check_forces[loaded], strict=True)
    ]
    believed: Array = np.linalg.norm(np.array([visit.coil for visit in heavy]) - np.array(expected), axis=1)
    checks = _checks(subject, sensors, visits, effort)
    return TubesResult(found, sensors, checks, all_, under_load, believed, tuple(visits), tuple(check))


def _visits(subject: Subject, effort: Effort) -> Procedure[tuple[list[Visit], list[Visit]]]:
    """Without load, then under each weight and without again; visits to fit and visits to check with."""
    what = quantities(subject.robot)
    total, number, at = effort.steps(), 0, subject.start
    visits: list[Visit] = []
    check: list[Visit] = []

    def rest(poses: Array, weight: float, into: list[Visit]) -> Procedure[None]:
        nonlocal number, at
        for joints in poses:
            visit = yield GoTo(joints, weight, min(number / total, 1.0))
            into += [visit] if isinstance(visit, Visit) else []
            number, at = number + 1, joints

    poses, known = subject.tour(what, np.zeros(3), effort.unloaded, None, at)
    yield from rest(poses, 0.0, visits)
    for weight in effort.weights:
        pull = weight * GRAVITY
        yield from rest(subject.start[None, :], 0.0, visits)
        yield Ask(f"Hang a weight of {weight:g} N at the tip.", weight, number / total)
        poses, known = subject.tour(what, pull, effort.loaded, known, at)
        yield from rest(poses, weight, visits)
        if effort.check:
            yield from rest(subject.scattered(pull, effort.check, at), weight, check)
        yield Ask("Take the weight off.", 0.0, number / total)
        poses, known = subject.tour(what, np.zeros(3), effort.between, known, at)
        yield from rest(poses, 0.0, visits)
    return visits, check


def _forces(subject: Subject, sensors: SensorCalibration, visits: Sequence[Visit]) -> Array:
    """Measured tip forces (m, 3) [N]; exactly none where nothing hangs."""
    return np.array([
        np.zeros(3) if visit.weight == 0.0 else sensors.load(subject.robot, visit).force for visit in visits
    ])  # fmt: skip


def _tips(subject: Subject, frames: Frames, visits: Sequence[Visit], forces: Array) -> Array:
    """Measured tips (m, 3), robot's frame [m]; the coil's place is carried back along the model's frame."""
    turns = [
        subject.statics.solve(visit.joints, np.concatenate((force_, np.zeros(3)))).rotation
        for visit, force_ in zip(visits, forces, strict=True)
    ]
    coils = frames.registration.apply(np.array([visit.coil for visit in visits]))
    return coils - np.array([turn @ frames.coil for turn in turns])


def _checks(
    subject: Subject, sensors: SensorCalibration, visits: Sequence[Visit], effort: Effort
) -> tuple[tuple[float, WeightCheck], ...]:
    """Each known weight as the calibrated sensors measure it."""
    found: list[tuple[float, WeightCheck]] = []
    for weight in effort.weights:
        felt = np.array([sensors.load(subject.robot, visit).force for visit in visits if visit.weight == weight])
        found.append((weight, check_weight(felt, weight, GRAVITY)))
    return tuple(found)
