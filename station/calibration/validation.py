"""The model held against measured poses: as described, with the best frames, with the best tubes.

Beside the errors at the poses of the fit stand those at poses that it has not seen: of another file, or, when there is
none, of every second pose after a fit to the others.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from core.calibration.fit import INTERVAL, Fit, Unobservable
from core.calibration.measured import FAR, Asked, Extent, Match, Spread, askable, match, suspicions
from core.calibration.measurements import Measurement
from core.calibration.rigid import vector_of
from core.calibration.tubes import TubeCalibration
from core.errors import CtrError
from core.robot.robot import Array, Robot
from station.calibration.poses import Poses
from station.calibration.summary import Row, frame_rows, tube_rows
from station.config.robots import RobotFile

EXTENTS: tuple[Extent, ...] = ("none", "frames", "tubes")
WORDS = {
    "none": "nothing fitted",
    "frames": "frames fitted",
    "tubes": "tubes fitted",
}
#: More values of a joint than this are put into so many bins.
VALUES, BINS = 12, 6
#: More poses than this are thinned out for the fits; errors are those of all.
FITTED = 1500
#: Part of the robot's length from which on a median error is asked about.
LARGE = 0.05
#: Part of the median error by which rising and falling must differ to be named.
WORTH = 0.25
#: Correlation of neighbouring errors that is said.
ALIKE = 0.3


class Unseen(NamedTuple):
    """What a match is worth at poses that its fit has not seen."""

    extent: Extent
    fitted: Spread
    tested: Spread


class Bin(NamedTuple):
    """Poses at which a joint is somewhere, or came one way."""

    joint: str
    where: str
    spread: Spread
    along: tuple[float, float, float]  #: mean error [m]


class NoOrderError(CtrError):
    """A lag was asked for, and the poses do not tell their order."""


@dataclass(frozen=True)
class Validation:
    """A robot's model and measured poses."""

    file: RobotFile
    robot: Robot
    poses: Poses
    test: Poses | None
    asked: Asked
    matches: tuple[Match, ...]  #: of growing extent
    errors: tuple[Array, ...]  #: of each match at the poses (m, 3) [m]
    unseen: tuple[Unseen, ...]
    failed: str  #: why the largest extent that was asked for is not among the matches; empty: it is
    suspicious: tuple[tuple[str, float, float], ...]
    stride: int  #: every so many-th pose was fitted

    @property
    def best(self) -> Match:
        """The one of the largest extent."""
        return self.matches[-1]


def validate(file: RobotFile, poses: Poses, extent: Extent, *, test: Poses | None, hysteresis: bool) -> Validation:
    """Hold a robot's model against measured poses.

    Args:
        file: the robot as described.
        poses: to fit to.
        extent: how much may be fitted.
        test: others, to test with; None: every second of `poses` after a fit to the others.
        hysteresis: whether each joint may stay behind the way that it came.

    Raises:
        NoOrderError: a lag of poses without times.
        Unobservable: too few poses even for the frames.
    """
    if hysteresis and not all(each.timed for each in (poses, test) if each is not None):
        raise NoOrderError(
            f"{poses.path if not poses.timed or test is None else test.path}: --hysteresis needs to know in which order"
            " the poses were visited: add a column 'time' [s]"
        )
    if hysteresis and extent == "none":
        raise NoOrderError("--hysteresis fits a lag; choose --fit frames or --fit tubes")
    robot, stride = file.robot(), -(-len(poses.measurements) // FITTED)
    measurements, forces = poses.measurements[::stride], poses.forces[::stride]
    others = (*poses.measurements, *(() if test is None else test.measurements))
    asked = askable(robot, measurements, forces, hysteresis=hysteresis, others=others)
    matches: list[Match] = []
    unseen: list[Unseen] = []
    failed = ""
    for each in EXTENTS[: EXTENTS.index(extent) + 1]:
        try:
            found = match(robot, measurements, forces, each, asked)
            tested = _unseen(robot, measurements, forces, test, found, asked)
        except CtrError as error:
            if each != "tubes":
                raise
            failed = f"The tubes could not be fitted: {error}"
            break
        matches.append(found)
        unseen += tested
    suspicious = suspicions(robot, measurements, forces) if extent != "none" else ()
    errors = tuple(found.errors(poses.measurements, poses.forces) for found in matches)
    return Validation(
        file, robot, poses, test, asked, tuple(matches), errors, tuple(unseen), failed, suspicious, stride
    )  # fmt: skip


def _unseen(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, test: Poses | None, found: Match, asked: Asked
) -> list[Unseen]:
    """Errors at the poses of the fit and at others; none where every second pose is too few."""
    if test is not None:
        fitted = Spread.of(found.errors(measurements, forces))
        return [Unseen(found.extent, fitted, Spread.of(found.errors(test.measurements, test.forces)))]
    if found.fit is None:
        return []
    first, second = ((measurements[start::2], forces[start::2]) for start in (0, 1))
    try:
        half = match(robot, *first, found.extent, asked)
    except CtrError:
        return []  # said in the findings
    return [Unseen(found.extent, *(Spread.of(half.errors(*each)) for each in (first, second)))]


def by_joint(validation: Validation) -> list[Bin]:
    """Errors of the best match, by where each joint is."""
    joints, errors = (
        np.array([measurement.joints for measurement in validation.poses.measurements]),
        validation.errors[-1],
    )
    found: list[Bin] = []
    for k, joint in enumerate(validation.robot.joints):
        column, (factor, unit) = joints[:, k], _shown(joint.unit)
        values = np.unique(np.round(column, 6))
        if len(values) == 1:
            continue
        if len(values) <= VALUES:
            parts = [(f"{factor * v:.1f} {unit}", np.abs(column - v) < 1e-6) for v in values.tolist()]
        else:
            edges = np.linspace(column.min(), column.max(), BINS + 1)
            where = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, BINS - 1)
            parts = [
                (f"{factor * edges[b]:.1f} ... {factor * edges[b + 1]:.1f} {unit}", where == b) for b in range(BINS)
            ]
        found += [_bin(joint.name, text, errors[there]) for text, there in parts if there.any()]
    return found


def by_direction(validation: Validation) -> list[Bin]:
    """Errors of the best match, by which way each joint came; empty where the order is not known.

    Without the poses that are far off: a single one of them would be most of a mean.
    """
    if not validation.poses.timed:
        return []
    lengths = np.linalg.norm(validation.errors[-1], axis=1)
    near = lengths <= FAR * np.nanmedian(lengths)
    errors = validation.errors[-1][near]
    ways_ = np.array([measurement.came for measurement in validation.poses.measurements])[near]
    return [
        _bin(joint.name, text, errors[ways_[:, k] == way])
        for k, joint in enumerate(validation.robot.joints)
        for text, way in (("rising", 1.0), ("falling", -1.0))
        if (ways_[:, k] == way).any()
    ]


def _bin(joint: str, where: str, errors: Array) -> Bin:
    x, y, z = np.nanmean(errors, axis=0).tolist() if np.isfinite(errors).any() else (math.nan,) * 3
    return Bin(joint, where, Spread.of(errors), (x, y, z))


def _shown(unit: str) -> tuple[float, str]:
    """How a person reads a joint's unit."""
    return (180.0 / math.pi, "deg") if unit == "rad" else (1e3, "mm")


def findings(validation: Validation) -> list[str]:
    """What a person should know, in sentences."""
    return [
        *([validation.failed] if validation.failed else []),
        *_size_words(validation),
        *_prior_words(validation.best),
        *_told_words(validation),
        *_direction_words(validation),
        *_pose_words(validation),
    ]


def _size_words(validation: Validation) -> Iterator[str]:
    """Errors that no tubes explain, and readings of the joints with which they would be less."""
    median, length = Spread.of(validation.errors[-1]).median, max(tube.length for tube in validation.robot.tubes)
    if median > LARGE * length:
        ask = "is the tips' frame the robot's? --fit frames finds it" if validation.best.fit is None else (
            "are joints, signs, units and zeros what the columns say?"
        )  # fmt: skip
        yield f"The median error is {1e3 * median:.1f} mm on a robot of {1e3 * length:.0f} mm: {ask}"
    for what, other, given in validation.suspicious[:1]:
        yield (
            f"The poses fit much better with {what}: {1e3 * other:.2f} mm mean with the frames fitted instead of"
            f" {1e3 * given:.2f} mm. Is that how they were written down?"
        )


def _told_words(validation: Validation) -> Iterator[str]:
    """How much the poses say."""
    best, count = validation.best, len(validation.poses.measurements)
    if best.held:
        names = ", ".join(name.replace("_", " ") for name in best.held)
        yield f"The data say less than was known beforehand of: {names}."
    if open_ := _open(best):
        yield f"Combinations that they cannot tell: {len(open_)}, weakest first: {'; '.join(open_[:2])}."
    if best.alike > ALIKE:
        yield (
            f"Errors of neighbouring poses are alike (correlation {best.alike:.2f}): they are the model's, not the"
            f" measurement's. {count} poses were counted as {count * (1.0 - best.alike) / (1.0 + best.alike):.0f}."
        )
    if validation.stride > 1:
        yield f"Every {validation.stride}th pose was fitted; the errors are those of all."
    for reason in best.asked.left:
        if best.extent == "tubes" or reason.startswith("lag"):
            yield f"Not asked for: {reason}."


def _direction_words(validation: Validation) -> Iterator[str]:
    """Joints whose way matters."""
    for joint, apart in _apart(by_direction(validation)):
        if apart > WORTH * Spread.of(validation.errors[-1]).median:
            yield f"{joint}: between rising and falling the mean error differs by {1e3 * apart:.2f} mm" + (
                "." if validation.best.asked.lags else "; --hysteresis fits a lag."
            )


def _pose_words(validation: Validation) -> Iterator[str]:
    """Poses that were not used, one way or another."""
    best, lengths = validation.best, np.linalg.norm(validation.errors[-1], axis=1)
    if lost := int(np.count_nonzero(~np.isfinite(lengths))):
        yield f"Poses at which this model has no shape: {lost}; they are not counted."
    if best.fit is not None and (out := [k for k, seen in enumerate(best.fitted) if not seen]):
        far = sorted(out, key=lambda k: -np.nan_to_num(lengths[validation.stride * k], nan=math.inf))
        lines = ", ".join(str(validation.poses.lines[validation.stride * k]) for k in far[:10])
        yield (
            f"Not fitted: {len(out)} of {len(best.fitted)} poses (lines {lines}), with errors of more than {FAR:g}"
            " times the median, or where the model is about to snap: another shape of the tubes, or a slip of the"
            " measurement? Their errors count."
        )
    if best.fit is not None and all(unseen.extent != best.extent for unseen in validation.unseen):
        yield "Not tested: every second pose is too few for a fit."
    for poses in (validation.poses, validation.test):
        if poses is not None and poses.left_out:
            yield f"Rows of {poses.path.name} that were left out: {len(poses.left_out)}; each is listed."


def _prior_words(best: Match) -> Iterator[str]:
    for parameter, value in best.surprising:
        yield (
            f"{parameter.name.replace('_', ' ')} came out {abs(value) / parameter.prior:.1f} standard deviations from"
            " what was known beforehand: check it, or the fit makes up for something else with it."
        )


def cannot_tell(best: Match) -> list[str]:
    """Parameters of which the data say less than was known beforehand, and combinations that they leave open."""
    return [f"{name.replace('_', ' ')}: less than was known beforehand" for name in best.held] + _open(best)


def _open(best: Match) -> list[str]:
    """Combinations, weakest first, each in what of its parameters would matter."""
    told: list[str] = []
    for combination in () if best.fit is None else best.fit.weak:
        shares = " ".join(f"{share:+.2f} {name.replace('_', ' ')}" for name, share in combination.parts)
        left = "not at all" if math.isinf(combination.open) else f"to {combination.open:.2g} times what matters"
        told.append(f"{shares} (known {left}{'; held by what was known beforehand' if combination.held else ''})")
    return told


def _apart(bins: Sequence[Bin]) -> list[tuple[str, float]]:
    """Joints, and how far the mean errors of both directions are apart [m]; pairs of bins only."""
    found: list[tuple[str, float]] = []
    for first, second in pairwise(bins):
        if first.joint == second.joint:
            found.append((first.joint, math.dist(first.along, second.along)))
    return found


def numbers(validation: Validation) -> dict[str, Any]:
    """For scripts; errors in mm, all else SI."""
    best = validation.best
    return {
        "robot": validation.robot.name,
        "poses": str(validation.poses.path),
        "test": None if validation.test is None else str(validation.test.path),
        "used": len(validation.poses.measurements),
        "left_out": [each._asdict() for each in validation.poses.left_out],
        "test_left_out": [] if validation.test is None else [each._asdict() for each in validation.test.left_out],
        "fit": best.extent,
        "failed": validation.failed or None,
        "errors_mm": {
            found.extent: _mm(Spread.of(errors))
            for found, errors in zip(validation.matches, validation.errors, strict=True)
        },
        "unseen_mm": {
            unseen.extent: {
                "how": "every second pose fitted, the others tested" if validation.test is None else "the other file",
                "fitted": _mm(unseen.fitted),
                "tested": _mm(unseen.tested),
            }
            for unseen in validation.unseen
        },
        "noise_mm": 1e3 * best.noise,
        "neighbours_alike": best.alike,
        "frames": {
            "rotation_vector": vector_of(best.frames.registration.rotation).tolist(),
            "position": best.frames.registration.position.tolist(),
            "offset": best.frames.coil.tolist(),
            "position_standard_deviation": best.position_errors.tolist(),
        },
        "parameters": _parameters(best),
        "cannot_tell": cannot_tell(best),
        "not_asked_for": list(best.asked.left),
        "by_joint": [_bin_numbers(each) for each in by_joint(validation)],
        "by_direction": [_bin_numbers(each) for each in by_direction(validation)],
        "findings": findings(validation),
    }


def _parameters(best: Match) -> dict[str, dict[str, Any]]:
    if best.fit is None:
        return {}
    values, errors = best.fit.values.tolist(), best.fit.errors.tolist()
    return {
        p.name: {
            "value": value,
            "standard_deviation": None if p.name in best.lost else error,
            "unit": p.unit,
            "known_beforehand": p.prior if math.isfinite(p.prior) else None,
            "told": p.name not in best.held and p.name not in best.lost,
        }
        for p, value, error in zip(best.fit.parameters, values, errors, strict=True)
    }


def _mm(spread: Spread) -> dict[str, float | int | None]:
    """Lengths that do not exist are null: JSON knows no NaN."""
    lengths = {key: 1e3 * value for key, value in spread._asdict().items() if key != "poses"}
    return {"poses": spread.poses, **{key: value if math.isfinite(value) else None for key, value in lengths.items()}}


def _bin_numbers(each: Bin) -> dict[str, Any]:
    return {
        "joint": each.joint,
        "where": each.where,
        **_mm(each.spread),
        "along_mm": [1e3 * a if math.isfinite(a) else None for a in each.along],
    }


def found_rows(validation: Validation) -> list[Row]:
    """Tubes, lags and frames that the best match found, as a person reads them."""
    best = validation.best
    if best.fit is None:
        return []
    tubes = _calibration(best, best.fit, validation.errors[-1])
    places = {f"frame position {a}": e for a, e in zip("xyz", best.position_errors.tolist(), strict=True)}
    rows = [
        row._replace(interval=f"{1e3 * INTERVAL * places[row.name]:.2g} mm") if row.name in places else row
        for row in (*tube_rows(tubes, validation.robot), *frame_rows(best.fit, best.frames))
    ]
    return [row._replace(interval="not known") if row.name in best.lost else row for row in rows]


def calibration(validation: Validation) -> TubeCalibration:
    """The tubes that were found, and all else with them.

    Raises:
        Unobservable: the tubes could not be fitted, or were not to be.
    """
    best = validation.best
    if best.fit is None or best.extent != "tubes":
        raise Unobservable(validation.failed or "the tubes were not fitted")
    return _calibration(best, best.fit, validation.errors[-1])


def _calibration(best: Match, fit: Fit, errors: Array) -> TubeCalibration:
    distances: Array = np.linalg.norm(errors, axis=1)
    return TubeCalibration(best.robot, best.frames, best.asked.quantities, fit, distances)
