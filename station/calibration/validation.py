"""Validation: compares a robot's model with measured poses, before and after fits of frames and tubes.

The errors are given at the poses of the fit and at held-out poses, which no fit used. Held-out poses are the
poses of another file, or every second pose after a fit to the other poses.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.calibration.external_poses import (
    OUTLIER_RATIO,
    ErrorStatistics,
    Extent,
    FitParameters,
    PoseFit,
    alternative_readings,
    fit_parameters,
    fit_poses,
)
from core.calibration.fit import NORMAL_QUANTILE_95, Fit, UnobservableCombination
from core.calibration.measurements import Measurement
from core.calibration.residual import Residual, residual
from core.calibration.tubes import TubeCalibration
from core.errors import CtrError
from core.robot.robot import Array, Robot
from station.calibration.poses import Poses
from station.calibration.summary import Row, frame_rows, tube_rows
from station.config.robots import RobotFile

EXTENTS: tuple[Extent, ...] = ("none", "frames", "tubes", "friction")
EXTENT_LABELS = {
    "none": "nothing fitted",
    "frames": "frames fitted",
    "tubes": "tubes fitted",
    "friction": "tubes and friction fitted",
}
#: Largest number of distinct values of a joint with one bin for each value; number of bins of a joint with more values.
MAX_DISTINCT_VALUES, BIN_COUNT = 12, 6
#: Largest number of poses for a fit; of more poses only every k-th is fitted. Errors are computed at all poses.
MAX_FITTED_POSES = 1500


class HeldOutResult(NamedTuple):
    """Errors of a fit at its poses and at held-out poses."""

    extent: Extent
    fitted: ErrorStatistics
    tested: ErrorStatistics


class ErrorBin(NamedTuple):
    """Errors of the poses at which a joint is in one range or arrived in one direction."""

    joint: str
    where: str
    spread: ErrorStatistics
    along: tuple[float, float, float]  #: mean error [m]


class NoOrderError(CtrError):
    """Error: a fit of lag or friction needs the order of the poses, but the file has no times."""


@dataclass(frozen=True)
class Validation:
    """Result of the comparison of a robot's model with measured poses."""

    file: RobotFile
    robot: Robot
    poses: Poses
    test: Poses | None
    requested: FitParameters
    matches: tuple[PoseFit, ...]  #: fits of increasing sets of parameters
    errors: tuple[Array, ...]  #: errors of each fit at the poses (m, 3) [m]
    held_out: tuple[HeldOutResult, ...]
    failed: str  #: reason why the requested set of parameters could not be fitted; empty if it was fitted
    suspicious: tuple[tuple[str, float, float], ...]
    stride: int  #: every `stride`-th pose was fitted
    residual: Residual  #: analysis of the best fit's errors

    @property
    def best(self) -> PoseFit:
        """The fit of the largest set of parameters."""
        return self.matches[-1]


def validate(file: RobotFile, poses: Poses, extent: Extent, *, test: Poses | None, hysteresis: bool) -> Validation:
    """Compare a robot's model with measured poses.

    Args:
        file: the robot file.
        poses: poses for the fits.
        extent: the largest set of parameters to fit.
        test: held-out poses; None: every second pose of `poses`, while the model is fitted to the other poses.
        hysteresis: whether to fit a lag of each joint, opposite to its direction of arrival.

    Raises:
        NoOrderError: the fit of a lag or of friction needs the times of the poses, which are missing.
        UnobservableCombination: the poses are too few to fit even the frames.
    """
    if hysteresis and not all(each.timed for each in (poses, test) if each is not None):
        raise NoOrderError(
            f"{poses.path if not poses.timed or test is None else test.path}: --hysteresis needs to know in which order"
            " the poses were visited: add a column 'time' [s]"
        )
    if extent == "friction" and not all(each.timed for each in (poses, test) if each is not None):
        raise NoOrderError(
            f"{poses.path if not poses.timed or test is None else test.path}: --fit friction needs the order in which"
            " the poses were visited: add a column 'time' [s], or use --fit tubes"
        )
    if hysteresis and extent == "none":
        raise NoOrderError("--hysteresis fits a lag; choose --fit frames or --fit tubes")
    robot, stride = file.robot(), -(-len(poses.measurements) // MAX_FITTED_POSES)
    measurements, forces = poses.measurements[::stride], poses.forces[::stride]
    others = (*poses.measurements, *(() if test is None else test.measurements))
    requested = fit_parameters(robot, measurements, forces, hysteresis=hysteresis, others=others)
    matches: list[PoseFit] = []
    held_out: list[HeldOutResult] = []
    failed = ""
    for each in EXTENTS[: EXTENTS.index(extent) + 1]:
        try:
            found = fit_poses(robot, measurements, forces, each, requested)
            tested = _held_out(robot, measurements, forces, test, found, requested)
        except CtrError as error:
            if each not in ("tubes", "friction"):
                raise
            failed = f"The {'tubes' if each == 'tubes' else 'friction'} could not be fitted: {error}"
            break
        matches.append(found)
        held_out += tested
    suspicious = alternative_readings(robot, measurements, forces) if extent != "none" else ()
    errors = tuple(found.errors(poses.measurements, poses.forces) for found in matches)
    return Validation(
        file, robot, poses, test, requested, tuple(matches), errors, tuple(held_out), failed, suspicious, stride,
        _residual(robot, poses, errors[-1], requested),
    )  # fmt: skip


def _residual(robot: Robot, poses: Poses, errors: Array, requested: FitParameters) -> Residual:
    """Return the analysis of the errors (m, 3) [m], without outliers, which would dominate the squared error."""
    lengths = np.linalg.norm(errors, axis=1)
    inliers = errors.copy()
    inliers[~(lengths <= OUTLIER_RATIO * np.nanmedian(lengths))] = math.nan
    joints = np.array([measurement.joints for measurement in poses.measurements])
    history = np.array([measurement.path for measurement in poses.measurements]) if poses.timed else None
    return residual(robot, joints, inliers, history, requested.windups)


def _held_out(
    robot: Robot,
    measurements: Sequence[Measurement],
    forces: Array,
    test: Poses | None,
    found: PoseFit,
    requested: FitParameters,
) -> list[HeldOutResult]:
    """Return the errors at the poses of the fit and at held-out poses; empty if half of the poses are too few."""
    if test is not None:
        fitted = ErrorStatistics.of(found.errors(measurements, forces))
        return [HeldOutResult(found.extent, fitted, ErrorStatistics.of(found.errors(test.measurements, test.forces)))]
    if found.fit is None:
        return []
    first, second = ((measurements[start::2], forces[start::2]) for start in (0, 1))
    try:
        half = fit_poses(robot, *first, found.extent, requested)
    except CtrError:
        return []  # the findings report that half of the poses are too few
    return [HeldOutResult(found.extent, *(ErrorStatistics.of(half.errors(*each)) for each in (first, second)))]


def by_joint(validation: Validation) -> list[ErrorBin]:
    """Return the errors of the best fit by the position of each joint."""
    joints, errors = (
        np.array([measurement.joints for measurement in validation.poses.measurements]),
        validation.errors[-1],
    )
    found: list[ErrorBin] = []
    for k, joint in enumerate(validation.robot.joints):
        column, (factor, unit) = joints[:, k], _display_unit(joint.unit)
        values = np.unique(np.round(column, 6))
        if len(values) == 1:
            continue
        if len(values) <= MAX_DISTINCT_VALUES:
            parts = [(f"{factor * v:.1f} {unit}", np.abs(column - v) < 1e-6) for v in values.tolist()]
        else:
            edges = np.linspace(column.min(), column.max(), BIN_COUNT + 1)
            where = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, BIN_COUNT - 1)
            parts = [
                (f"{factor * edges[b]:.1f} ... {factor * edges[b + 1]:.1f} {unit}", where == b)
                for b in range(BIN_COUNT)
            ]
        found += [_bin(joint.name, text, errors[there]) for text, there in parts if there.any()]
    return found


def by_direction(validation: Validation) -> list[ErrorBin]:
    """Return the errors of the best fit by the direction from which each joint arrived; empty without an order.

    Outliers are left out, because a single one would dominate a mean.
    """
    if not validation.poses.timed:
        return []
    lengths = np.linalg.norm(validation.errors[-1], axis=1)
    inliers = lengths <= OUTLIER_RATIO * np.nanmedian(lengths)
    errors = validation.errors[-1][inliers]
    arrivals = np.array([measurement.came for measurement in validation.poses.measurements])[inliers]
    return [
        _bin(joint.name, text, errors[arrivals[:, k] == direction])
        for k, joint in enumerate(validation.robot.joints)
        for text, direction in (("rising", 1.0), ("falling", -1.0))
        if (arrivals[:, k] == direction).any()
    ]


def _bin(joint: str, where: str, errors: Array) -> ErrorBin:
    x, y, z = np.nanmean(errors, axis=0).tolist() if np.isfinite(errors).any() else (math.nan,) * 3
    return ErrorBin(joint, where, ErrorStatistics.of(errors), (x, y, z))


def _display_unit(unit: str) -> tuple[float, str]:
    """Return the factor and the name of the display unit."""
    return (180.0 / math.pi, "deg") if unit == "rad" else (1e3, "mm")


def found_rows(validation: Validation) -> list[Row]:
    """Return tubes, lags and frames of the best fit in human-readable form."""
    best = validation.best
    if best.fit is None:
        return []
    tubes = _calibration(best, best.fit, validation.errors[-1])
    position_errors = {f"frame position {a}": e for a, e in zip("xyz", best.position_errors.tolist(), strict=True)}
    rows = [
        row._replace(interval=f"{1e3 * NORMAL_QUANTILE_95 * position_errors[row.name]:.2g} mm")
        if row.name in position_errors
        else row
        for row in (*tube_rows(tubes, validation.robot), *frame_rows(best.fit, best.frames))
    ]
    return [row._replace(interval="not known") if row.name in best.undetermined else row for row in rows]


def calibration(validation: Validation) -> TubeCalibration:
    """Return the fitted tubes, frames and lags.

    Raises:
        UnobservableCombination: the tubes could not be fitted, or their fit was not requested.
    """
    best = validation.best
    if best.fit is None or best.extent not in ("tubes", "friction"):
        raise UnobservableCombination(validation.failed or "the tubes were not fitted")
    return _calibration(best, best.fit, validation.errors[-1])


def _calibration(best: PoseFit, fit: Fit, errors: Array) -> TubeCalibration:
    distances: Array = np.linalg.norm(errors, axis=1)
    return TubeCalibration(best.robot, best.frames, best.requested.quantities, fit, distances)
