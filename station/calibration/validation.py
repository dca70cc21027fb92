"""Validation: compares a robot's model with measured poses, before and after fits of frames and tubes.

The errors are given at the poses of the fit and at held-out poses, which no fit used. Held-out poses are the
poses of another file, or every second pose after a fit to the other poses.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.calibration.external_poses import (
    OUTLIER_RATIO,
    ErrorStatistics,
    Extent,
    FitParameters,
    PoseFit,
    alternative_readings,
    check_tip_moves,
    fit_parameters,
    fit_poses,
    follows_model,
)
from core.calibration.fit import NORMAL_QUANTILE_95, Fit, UnobservableCombination
from core.calibration.measurements import Measurement
from core.calibration.residual import PoseErrors, Residual, fit_residual, predict_residual, residual
from core.calibration.tubes import TubeCalibration
from core.errors import CtrError
from core.robot.robot import Array, Robot
from station.calibration.poses import DEFAULT_TRAJECTORIES, Poses
from station.calibration.summary import Row, frame_rows, tube_rows
from station.config.robots import RobotFile

#: Fits that are made for each requested extent, in their order.
EXTENTS: Mapping[Extent, tuple[Extent, ...]] = {
    "none": ("none",),
    "frames": ("none", "frames"),
    "tubes": ("none", "frames", "tubes"),
    "friction": ("none", "frames", "tubes", "friction"),
    "residual": ("none", "frames", "tubes", "residual"),
}
EXTENT_LABELS = {
    "none": "nothing fitted",
    "frames": "frames fitted",
    "tubes": "tubes fitted",
    "friction": "tubes and friction fitted",
    "residual": "tubes fitted, residual learned",
}
#: Largest number of distinct values of a joint that get one bin each; number of bins of any other joint.
MAX_DISTINCT_VALUES, BIN_COUNT = 12, 6
#: Largest number of poses for a fit; if there are more, every k-th is fitted. Errors are computed at all poses.
MAX_FITTED_POSES = 400


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


class Extrapolation(NamedTuple):
    """Errors in one half of the workspace after a fit of the residual to the other half."""

    where: str  #: the half that was left out
    model: float  #: mean error of the model there [m]
    corrected: float  #: mean error with the residual there [m]


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
    residual: Residual  #: analysis of the errors of the best fit without a learned residual
    extrapolation: Extrapolation | None = None  #: errors of the residual outside its data; None: none was learned
    known: PoseErrors | None = None  #: errors of the best fit without a learned residual

    @property
    def best(self) -> PoseFit:
        """The fit of the largest set of parameters."""
        return self.matches[-1]

    @property
    def parts(self) -> tuple[str, str]:
        """Names of the fitted and of the held-out poses."""
        if self.best.extent == "residual":
            return "four fifths of the trajectories: fitted", "the others, in turn: tested"
        return "every second: fitted", "the others: tested"


def validate(
    file: RobotFile, poses: Poses, extent: Extent, *, test: Poses | None, hysteresis: bool,
    progress: Callable[[float], None] = lambda _: None,
) -> Validation:  # fmt: skip
    """Compare a robot's model with measured poses.

    Args:
        file: the robot file.
        poses: poses for the fits.
        extent: the largest set of parameters to fit.
        test: held-out poses; None: every second pose of `poses`, while the model is fitted to the other poses.
        hysteresis: whether to fit a lag of each joint, opposite to its direction of arrival.
        progress: receives the completed share.

    Raises:
        NoOrderError: the fit of a lag or of friction needs the times of the poses, which are missing.
        UnobservableCombination: the poses are too few to fit even the frames, or the tip does not move.
    """
    unordered = next((each.path for each in (poses, test) if each is not None and not each.timed), None)
    if unordered is not None and (hysteresis or extent == "friction"):
        raise NoOrderError(
            f"{unordered}: {'--hysteresis' if hysteresis else '--fit friction'} needs the order in which the poses were"
            " visited: add a column 'time' [s], or leave this option out"
        )
    if hysteresis and extent == "none":
        raise NoOrderError("--hysteresis fits a lag; choose --fit frames or --fit tubes")
    robot, stride = file.robot(), -(-len(poses.measurements) // MAX_FITTED_POSES)
    measurements, forces = poses.measurements[::stride], poses.forces[::stride]
    if extent != "none":
        check_tip_moves(robot, measurements, forces)
    others = (*poses.measurements, *(() if test is None else test.measurements))
    requested = fit_parameters(robot, measurements, forces, hysteresis=hysteresis, others=others)
    matches: list[PoseFit] = []
    held_out: list[HeldOutResult] = []
    failed = ""
    extents, splits, parts = EXTENTS[extent], _splits(poses, extent), list[PoseFit]()

    def refit(some: Sequence[Measurement], loads: Array) -> PoseFit:
        return fit_poses(robot, some, loads, each, requested)

    each: Extent

    for number, each in enumerate(extents):
        if each == "tubes" and not follows_model(matches[-1], measurements, forces):
            failed = (
                "The tubes were not fitted: with the best frames, the model predicts the tips little better than"
                " their mean position does. Do rows, columns, units and signs agree?"
            )
            break
        try:
            progress((number + 0.2) / (len(extents) + 1))
            if each == "residual":
                found = matches[-1].with_residual(poses.measurements, poses.forces, poses.trajectories)
            else:
                found = refit(measurements, forces)
            progress((number + 0.7) / (len(extents) + 1))
            tested, parts = _held_out(poses, stride, test, found, parts, splits, refit)
        except CtrError as error:
            if each in ("none", "frames"):
                raise
            failed = f"The {'friction' if each == 'friction' else 'tubes'} could not be fitted: {error}"
            break
        matches.append(found)
        held_out += tested
    progress(len(extents) / (len(extents) + 1))
    suspicious = alternative_readings(robot, measurements, forces) if extent != "none" else ()
    errors = tuple(found.errors(poses.measurements, poses.forces) for found in matches)
    plain = max(k for k, found in enumerate(matches) if found.extent != "residual")
    known = matches[plain].pose_errors(poses.measurements, poses.forces, _inliers(errors[plain]), poses.trajectories)
    return Validation(
        file, robot, poses, test, requested, tuple(matches), errors, tuple(held_out), failed, suspicious, stride,
        residual(known), _extrapolation(known) if extent == "residual" else None, known,
    )  # fmt: skip


def _inliers(errors: Array) -> Array:
    """Return errors (m, 3) with NaN for outliers, which would dominate the squared error."""
    lengths = np.linalg.norm(errors, axis=1)
    return np.where((lengths <= OUTLIER_RATIO * np.nanmedian(lengths))[:, None], errors, math.nan)


def _splits(poses: Poses, extent: Extent) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return the poses to fit again and those to test, as indices: complete trajectories for a residual."""
    index, names = np.arange(len(poses.measurements)), poses.trajectories
    if extent != "residual":
        return [(index[::2], index[1::2])]
    number = np.unique(names, return_inverse=True)[1] % DEFAULT_TRAJECTORIES
    return [(index[number != k], index[number == k]) for k in np.unique(number).tolist()]


def _held_out(
    poses: Poses, stride: int, test: Poses | None, found: PoseFit, base: Sequence[PoseFit],
    splits: Sequence[tuple[NDArray[np.int64], NDArray[np.int64]]],
    refit: Callable[[Sequence[Measurement], Array], PoseFit],
) -> tuple[list[HeldOutResult], list[PoseFit]]:  # fmt: skip
    """Return the errors at fitted and at held-out poses, and the fits; empty if a part has too few poses.

    `base` are the fits of the previous extent, which a residual corrects.
    """
    measurements, forces, names = poses.measurements, poses.forces, poses.trajectories
    if test is not None:
        fitted, tested = found.errors(measurements, forces), found.errors(test.measurements, test.forces)
        return [HeldOutResult(found.extent, ErrorStatistics.of(fitted), ErrorStatistics.of(tested))], []
    if found.fit is None:
        return [], []
    fits, errors = list[PoseFit](), tuple[list[Array], list[Array]]([[], []])
    for k, split in enumerate(splits):
        near = [[measurements[i] for i in part] for part in split]
        try:
            if found.extent == "residual":
                part = base[k].with_residual(near[0], forces[split[0]], names[split[0]])
            else:
                part = refit(near[0][::stride], forces[split[0][::stride]])
        except CtrError:
            return [], []  # the findings report that a part of the poses is too few
        fits.append(part)
        for into, some, rows in zip(errors, near, split, strict=True):
            into.append(part.errors(some, forces[rows]))
    return [HeldOutResult(found.extent, *(ErrorStatistics.of(np.concatenate(each)) for each in errors))], fits


def _extrapolation(poses: PoseErrors) -> Extrapolation | None:
    """Return the half of a joint's positions where the residual of the other half is worst; None: no joint moves."""
    found = list[Extrapolation]()
    poses = poses.usable
    for k, joint in enumerate(poses.robot.joints):
        column = poses.joints[:, k]
        if np.ptp(column) == 0.0:
            continue
        for text, out in (("upper", column > np.median(column)), ("lower", column < np.median(column))):
            values, _ = predict_residual(fit_residual(poses.of(~out)), poses.of(out))
            means = (
                float(np.linalg.norm(each, axis=1).mean()) for each in (poses.errors[out], poses.errors[out] - values)
            )
            found.append(Extrapolation(f"{text} half of {joint.name}", *means))
    return max(found, key=lambda each: each.corrected / each.model, default=None)


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
    if best.fit is None or best.extent not in ("tubes", "friction", "residual"):
        raise UnobservableCombination(validation.failed or "the tubes were not fitted")
    return _calibration(best, best.fit, validation.errors[-1])


def _calibration(best: PoseFit, fit: Fit, errors: Array) -> TubeCalibration:
    distances: Array = np.linalg.norm(errors, axis=1)
    return TubeCalibration(best.robot, best.frames, best.requested.quantities, fit, distances)
