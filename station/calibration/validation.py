"""The model held against measured poses: as described, with the best frames, with the best tubes.

Beside the errors at the poses of the fit stand those at poses that it has not seen: of another file, or, when there is
none, of every second pose after a fit to the others.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.calibration.fit import INTERVAL, Fit, Unobservable
from core.calibration.measured import FAR, Asked, Extent, Match, Spread, askable, match, suspicions
from core.calibration.measurements import Measurement
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
