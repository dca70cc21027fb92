"""Comparison of externally measured poses with the model: with the robot file's values, fitted frames, or fitted tubes.

The fit is the one of `prediction`, with these differences:

* The measurement noise is unknown. The fit is repeated with the residual of the last fit as standard deviation of each
  axis, until residual and standard deviation agree. Priors then have the right weight even if the model itself is
  inaccurate.
* Poses whose neighbours have similar errors (`neighbour_correlation`) count as fewer poses.
* The fit excludes outliers, for example measurement mistakes and poses at which the tubes snapped to another shape.
* The measured point may be centimetres from the tip.
* A joint may lag by much more than a drive's play, because friction twists the tubes. With the extent `friction` the
  fit includes a wind-up of each tube, computed from the order of the poses (`residual.wind_ups`).

The fit includes only parameters that the poses can determine (`fit_parameters`). `Fit.weak` lists the parameter
combinations that the poses do not determine.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.calibration.fit import MAX_STEPS, Fit, Parameter, UnobservableCombination, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Lag, NoEquilibrium, Prediction, predict
from core.calibration.quantities import MIN_TUBE_DISTANCE_M, Quantity, end_distances, quantities
from core.calibration.registration import closed_form
from core.calibration.residual import (
    PoseErrors,
    Windup,
    direction_states,
    fit_residual,
    predict_residual,
    relative_rotations,
    turned_tubes,
)
from core.calibration.rigid_transform import RigidTransform, cross_matrix
from core.calibration.tubes import MIN_LOADED_MEASUREMENTS
from core.control.tip_residual import TipResidual
from core.errors import CtrError
from core.robot.robot import Array, Robot

Extent = Literal["none", "frames", "tubes", "friction", "residual"]

#: Standard deviation of the prior of the measured point's offset from the tip, in each axis [m].
POINT_OFFSET_STD_M = 0.030
#: Standard deviation of the prior of a joint's lag behind its motion, by the joint's unit [rad, m].
LAG_PRIOR = {"rad": 0.05, "m": 1e-3}
#: Initial and smallest standard deviation of a measured point [m].
FIRST_POINT_STD_M, MIN_POINT_STD_M = 0.5e-3, 1e-6
#: Largest number of repetitions of the fit, and relative change of the estimated noise at which they stop.
MAX_ROUNDS, MAX_RELATIVE_CHANGE = 8, 0.05
#: Largest number of steps in a repetition, which starts from the values of the round before.
MAX_REPEATED_STEPS = 12
#: Upper bound of the correlation between the errors of neighbouring poses.
MAX_CORRELATION = 0.9
#: Poses with errors above `OUTLIER_RATIO` times the median error are outliers, unless more than the fraction
#: `MAX_OUTLIER_SHARE` of all poses exceeds this bound.
OUTLIER_RATIO, MAX_OUTLIER_SHARE = 4.0, 0.1
#: Smallest tip force that counts as a load [N].
MIN_LOAD_N = 0.05
#: A joint counts as reversed if it moves back by more than this fraction of its range in the data.
MIN_REVERSAL_SHARE = 2e-3
#: An alternative interpretation of the joint values is reported if its mean error is below this fraction of the mean
#: error of the given values.
MAX_ALTERNATIVE_ERROR_RATIO = 0.5
#: Number of poses on which alternative interpretations of the joint values are tested.
ALTERNATIVE_SAMPLE_SIZE = 200
#: A tip counts as stationary if its median distance from its middle is below this fraction of the model tip's.
STILL_TIP_RATIO = 0.1
#: Median error with the best frames, as a fraction of the points' median distance from their middle, above which the
#: points have no relation to the joints: frames fitted to few unrelated points reach about 0.8.
MAX_UNRELATED_ERROR = 0.6


class FitParameters(NamedTuple):
    """Parameters that a fit to measured poses estimates."""

    quantities: tuple[Quantity, ...] = ()
    lags: tuple[Lag, ...] = ()
    windups: tuple[Windup, ...] = ()
    omitted: tuple[str, ...] = ()  #: parameters that are not fitted, each with the reason


class ErrorStatistics(NamedTuple):
    """Number of poses, and statistics of the distances between measured and predicted points [m]."""

    poses: int
    mean: float
    median: float
    p95: float
    largest: float

    @classmethod
    def of(cls, errors: Array) -> "ErrorStatistics":
        """Return the statistics of errors (m, 3) [m]; rows with NaN are ignored; without other rows all are NaN."""
        lengths = np.linalg.norm(errors[np.isfinite(errors).all(axis=1)], axis=1)
        if not lengths.size:
            return cls(0, math.nan, math.nan, math.nan, math.nan)
        p50, p95 = np.percentile(lengths, (50.0, 95.0)).tolist()
        return cls(len(lengths), float(lengths.mean()), p50, p95, float(lengths.max()))


@dataclass(frozen=True)
class PoseFit:
    """The model after a fit to poses with one extent."""

    extent: Extent
    robot: Robot
    frames: Frames
    plays: Array  #: (n,) play of each joint [rad or m]
    half_lags: Array  #: (q,) largest wind-up of each tube by friction [rad]
    noise: float  #: standard deviation of the residual in each axis [m]
    neighbour_correlation: float  #: correlation of the errors of neighbouring poses, 0 ... `MAX_CORRELATION`
    requested: FitParameters  #: parameters of the tubes, lags and wind-ups that were fitted
    fit: Fit | None  #: result of the fit; None: nothing was fitted
    fitted: tuple[bool, ...]  #: whether the fit used each pose
    middle: Array  #: (3,) centre of the fitted rotation, robot's frame [m]
    learned: TipResidual | None = None  #: learned residual; None: not fitted, or it predicts nothing

    def errors(self, measurements: Sequence[Measurement], forces: Array) -> Array:
        """Return measured minus predicted points (m, 3), robot's frame [m], of any poses under tip forces (m, 3) [N].

        Rows are NaN where this model has no shape.
        """
        found = _errors(self.robot, self.frames, self.plays, self.half_lags, measurements, forces)
        return found - predict_residual(self.learned, self.pose_errors(measurements, forces, found))[0]

    def pose_errors(
        self, measurements: Sequence[Measurement], forces: Array, errors: Array,
        trajectories: NDArray[np.int64] | None = None,
    ) -> PoseErrors:  # fmt: skip
        """Return errors (m, 3) [m] at poses together with the quantities that predict them."""
        history = [measurement.path for measurement in measurements if measurement.path is not None]
        directions = direction_states(self.robot, np.array(history)) if len(history) == len(measurements) else None
        joints = np.array([measurement.joints for measurement in measurements])
        if trajectories is None:
            trajectories = np.zeros(len(joints), dtype=np.int64)
        return PoseErrors(self.robot, joints, directions, forces, errors, trajectories)

    def with_residual(
        self, measurements: Sequence[Measurement], forces: Array, trajectories: NDArray[np.int64]
    ) -> "PoseFit":
        """Return this fit with the residual learned from its errors at poses; outliers are left out."""
        errors = self.errors(measurements, forces)
        lengths = np.linalg.norm(errors, axis=1)
        errors[~(lengths <= OUTLIER_RATIO * np.nanmedian(lengths))] = math.nan
        learned = fit_residual(self.pose_errors(measurements, forces, errors, trajectories))
        return replace(self, extent="residual", learned=learned)

    @property
    def position_errors(self) -> Array:
        """Standard deviations (3,) of the registration's position [m].

        The fit's standard deviations apply at the middle of the measured points. At the origin of the points' frame,
        the rotation error adds to them, in proportion to the origin's distance from this middle.
        """
        if self.fit is None:
            return np.zeros(3)
        first = [parameter.name for parameter in self.fit.parameters].index("frame rotation x")
        covariance = self.fit.covariance[first : first + 6, first : first + 6]
        carry = np.hstack((-cross_matrix(self.frames.registration.position - self.middle), np.eye(3)))
        return np.sqrt(np.diag(carry @ covariance @ carry.T))

    @property
    def undetermined(self) -> frozenset[str]:
        """Parameters that neither the poses nor a prior determine."""
        weak = () if self.fit is None else self.fit.weak
        unknown = [each for each in weak if math.isinf(each.open) and not each.fixed_by_prior]
        return frozenset(name for each in unknown for name, _ in each.parts)

    @property
    def far_from_prior(self) -> tuple[tuple[Parameter, float], ...]:
        """Parameters more than two standard deviations from their prior, with their values [their unit]."""
        if self.fit is None:
            return ()
        values: list[float] = self.fit.values.tolist()
        pairs = zip(self.fit.parameters, values, strict=True)
        return tuple((parameter, value) for parameter, value in pairs if abs(value) > 2.0 * parameter.prior)

    @property
    def fixed_by_prior(self) -> tuple[str, ...]:
        """Parameters that the prior determines more than the poses: the data reduce the variance by less than half."""
        if self.fit is None:
            return ()
        errors: list[float] = self.fit.errors.tolist()
        pairs = zip(self.fit.parameters, errors, strict=True)
        return tuple(parameter.name for parameter, error in pairs if error * error > 0.5 * parameter.prior**2)


def fit_poses(
    robot: Robot, measurements: Sequence[Measurement], forces: Array, extent: Extent, requested: FitParameters
) -> PoseFit:
    """Fit the model to poses under tip forces (m, 3) [N] with the parameters of `extent`.

    Args:
        robot: robot with the robot file's values.
        measurements: measured poses; `coil` is the measured point.
        forces: tip forces in the world frame.
        extent: `none` fits nothing and assumes points in the robot's frame, measured at the tip. `frames` fits a rigid
            transform and the point's position in the tip frame. `tubes` also fits the tubes, `friction` also their
            wind-ups.
        requested: result of `fit_parameters`; `frames` and later extents fit the lags, `tubes` and `friction` the
            quantities, `friction` the wind-ups.

    Raises:
        UnobservableCombination: there are too few poses for the unknowns.
        CtrError: the model has no shape at a pose.

    """
    if extent == "none":
        frames = Frames(RigidTransform(np.eye(3), np.zeros(3)), np.zeros(3), np.zeros(3))
        nothing = (False,) * len(measurements)
        still = np.zeros(len(robot.joints)), np.zeros(len(robot.tubes))
        return PoseFit(extent, robot, frames, *still, 0.0, 0.0, FitParameters(), None, nothing, np.zeros(3))
    what = requested.quantities if extent in ("tubes", "friction") else ()
    windups = requested.windups if extent == "friction" else ()
    unknown = len(what) + len(requested.lags) + len(windups) + 9
    if 3 * len(measurements) < unknown + 3:
        raise UnobservableCombination(
            f"usable poses: {len(measurements)}, for {unknown} unknowns ({extent});"
            f" at least {unknown // 3 + 1} are needed"
        )
    start, noise, values = closed_form(robot, measurements, forces), FIRST_POINT_STD_M, None
    joints = np.array([measurement.joints for measurement in measurements])
    unsolvable = np.zeros(len(measurements), bool)
    kept, max_outliers, rounds = ~unsolvable, max(1, int(MAX_OUTLIER_SHARE * len(measurements))), 0
    while True:
        used: list[int] = np.flatnonzero(kept).tolist()
        near = [measurements[k] for k in used]
        problem = Prediction(
            robot, what, near, forces[kept], Noise(coil=noise), start, POINT_OFFSET_STD_M, requested.lags, windups
        )
        try:
            found = fit(problem, problem.parameters, values, MAX_STEPS if values is None else MAX_REPEATED_STEPS)
        except NoEquilibrium as error:
            # Near a snap, tubes with slightly different parameters may have no shape at this pose: omit the pose.
            unsolvable[used[error.measurement]] = True
            kept = kept & ~unsolvable
            if np.count_nonzero(unsolvable) > max_outliers:
                raise
            continue
        values, rounds = found.values, rounds + 1
        tubes, frames, plays = problem.tubes(values), problem.frames(values), problem.plays(values)
        half_lags = problem.half_lags(values)
        errors = _errors(tubes, frames, plays, half_lags, measurements, forces)
        remaining = max(noise * math.sqrt(found.variance_factor), MIN_POINT_STD_M)
        correlation = neighbour_correlation(joints[kept], errors[kept])
        before, noise = noise, remaining * math.sqrt((1.0 + correlation) / (1.0 - correlation))
        fitted, kept = kept, _inliers(errors, max_outliers) & ~unsolvable
        if rounds == MAX_ROUNDS or (abs(noise - before) <= MAX_RELATIVE_CHANGE * before and (kept == fitted).all()):
            actual = requested._replace(quantities=what, windups=windups)
            rows = tuple(fitted.tolist())
            state = plays, half_lags
            return PoseFit(extent, tubes, frames, *state, remaining, correlation, actual, found, rows, problem.middle)


def _inliers(errors: Array, max_outliers: int) -> NDArray[np.bool_]:
    """Return whether each error (m, 3) is at most `OUTLIER_RATIO` times the median, or finite if too many exceed it."""
    lengths = np.linalg.norm(errors, axis=1)
    near = lengths <= OUTLIER_RATIO * float(np.nanmedian(lengths))
    return near if np.count_nonzero(~near) <= max_outliers else np.isfinite(lengths)


def _errors(
    robot: Robot, frames: Frames, plays: Array, half_lags: Array, measurements: Sequence[Measurement], forces: Array
) -> Array:
    """Return measured minus predicted points (m, 3), robot's frame [m]; NaN where the model has no shape."""
    solved = predict(robot, measurements, forces, plays, half_lags=half_lags)
    points = np.array([measurement.coil for measurement in measurements])
    return frames.registration.apply(points) - solved.tip - solved.rotation @ frames.coil


def neighbour_correlation(joints: Array, errors: Array) -> float:
    """Return the correlation of errors (m, 3) with those at the nearest other joints (m, n), 0 ... `MAX_CORRELATION`.

    Measurement noise is not correlated between poses; model errors are. With correlation r, m successive errors have
    as much information as m (1 - r) / (1 + r) independent errors.
    """
    scaled = joints / np.maximum(np.ptp(joints, axis=0), 1e-12)
    power = float(np.sum(errors * errors))
    if len(joints) < 3 or power == 0.0:
        return 0.0
    nearest: list[int] = []
    for k, pose in enumerate(scaled):
        apart = np.sum((scaled - pose) ** 2, axis=1)
        apart[k] = math.inf
        nearest.append(int(np.argmin(apart)))
    return float(np.clip(np.sum(errors * errors[nearest]) / power, 0.0, MAX_CORRELATION))


def check_tip_moves(robot: Robot, measurements: Sequence[Measurement], forces: Array) -> None:
    """Reject points that stay in one place although the joints move the model's tip.

    Raises:
        UnobservableCombination: the points do not move; the text states how far points, joints and model move.

    """
    points = np.array([measurement.coil for measurement in measurements])
    joints = np.array([measurement.joints for measurement in measurements])
    tips = predict(robot, measurements, forces).tip
    measured, expected = _spread(points), _spread(tips[np.isfinite(tips).all(axis=1)])
    if measured >= STILL_TIP_RATIO * expected:
        return
    travels: list[float] = np.ptp(joints, axis=0).tolist()
    moved = ", ".join(
        f"{joint.name} {math.degrees(travel):.0f} deg" if joint.unit == "rad" else f"{joint.name} {1e3 * travel:.3g} mm"
        for joint, travel in zip(robot.joints, travels, strict=True)
    )
    raise UnobservableCombination(
        f"the tip does not move: half of {len(points)} measured tips are within {1e3 * measured:.3g} mm of their"
        f" middle, but the model's tips are within {1e3 * expected:.3g} mm (the joints move: {moved}). Does the tracker"
        " measure the robot's tip, do the tip's columns contain it in metres, and do rows belong to their joints?"
    )


def follows_model(found: PoseFit, measurements: Sequence[Measurement], forces: Array) -> bool:
    """Return whether the errors are below `MAX_UNRELATED_ERROR` times the points' distances from their middle."""
    spread = _spread(np.array([measurement.coil for measurement in measurements]))
    return _median_length(found.errors(measurements, forces)) < MAX_UNRELATED_ERROR * spread


def _spread(points: Array) -> float:
    """Return the median distance of points (m, 3) from their middle [m]."""
    return _median_length(points - np.median(points, axis=0))


def _median_length(vectors: Array) -> float:
    return float(np.nanmedian(np.linalg.norm(vectors, axis=1)))


def fit_parameters(
    robot: Robot,
    measurements: Sequence[Measurement],
    forces: Array,
    *,
    hysteresis: bool,
    others: Sequence[Measurement] = (),
) -> FitParameters:
    """Return the parameters that a fit to `measurements` under tip forces (m, 3) [N] can determine.

    Fitted values of these parameters also keep the poses `others` valid. Without load the poses determine only ratios
    of stiffness, so the outermost tube's stiffness is fixed. A tube that ends flush with a neighbour in some pose keeps
    its total length, because this pose shows that the ends coincide; only the start of the tube's curve is fitted. The
    lag of such a tube's translation is not fitted, either.
    """
    kept: list[Quantity] = []
    lags: list[Lag] = []
    omitted: list[str] = []
    loaded = int(np.count_nonzero(np.linalg.norm(forces, axis=1) > MIN_LOAD_N))
    joints = [measurement.joints for measurement in (*measurements, *others)]
    for quantity in quantities(robot, joints):
        if quantity.kind == "end":
            continue  # few poses determine the effective end of an outer tube, and other models lack this parameter
        name = quantity.parameter(robot).name.replace("_", " ")
        if (
            quantity.kind == "bending_stiffness"
            and quantity.tube == len(robot.tubes) - 1
            and loaded < MIN_LOADED_MEASUREMENTS
        ):
            omitted.append(
                f"{name}: {loaded} poses under more than {MIN_LOAD_N:g} N; without load the poses determine only"
                " ratios of stiffness, so the outermost tube keeps the stiffness of the robot file"
            )
        elif quantity.kind != "poisson_ratio":
            kept.append(quantity)
        if quantity.kind == "curve_start":
            omitted.append(
                f"{robot.tubes[quantity.tube].name} straight length: in some pose the tube's end is within"
                f" {1e3 * MIN_TUBE_DISTANCE_M:g} mm of its neighbour's; its total length is fixed, and the start of"
                " its curve is fitted"
            )
    # The torsional stiffness replaces Poisson's ratio as fit parameter.
    kept += [Quantity(tube, "torsional_stiffness") for tube in range(len(robot.tubes))]
    distances = np.minimum(end_distances(robot, joints), _start_distances(robot, joints))
    for k, joint in enumerate(robot.joints) if hysteresis else ():
        came = np.array([0.0 if measurement.came is None else measurement.came[k] for measurement in measurements])
        if not ((came > 0.0).any() and (came < 0.0).any()):
            omitted.append(f"lag of {joint.name}: the joint did not approach poses from both sides")
        elif joint.motion == "translation" and distances[joint.tube] < MIN_TUBE_DISTANCE_M:
            omitted.append(
                f"lag of {joint.name}: in some pose the tube is within {1e3 * MIN_TUBE_DISTANCE_M:g} mm of the plate or"
                " of its neighbour's end"
            )
        else:
            lags.append(Lag(k, LAG_PRIOR[joint.unit]))
    windups: list[Windup] = []
    rotations = relative_rotations(robot, np.array([measurement.joints for measurement in measurements]))
    for each in turned_tubes(robot) if all(measurement.path is not None for measurement in measurements) else ():
        if np.ptp(rotations[:, each.tube]) > 0.0:
            windups.append(each)
        else:
            omitted.append(f"half lag of {robot.tubes[each.tube].name}: the tube did not turn in its neighbour")
    return FitParameters(tuple(kept), tuple(lags), tuple(windups), tuple(omitted))


def arrival_directions(joints: Array) -> Array:
    """Return each joint's direction of arrival (m, n), -1, 0 (not moved yet) or 1, for an ordered series (m, n)."""
    found = np.zeros_like(joints)
    for k, column in enumerate(joints.T):
        threshold = max(MIN_REVERSAL_SHARE * float(np.ptp(column)), 1e-9)
        direction, low, high = 0.0, column[0], column[0]
        for row, value in enumerate(column.tolist()):
            # `low` and `high` are the extremes since the last reversal; a motion back from an extreme is a reversal.
            low, high = min(low, value), max(high, value)
            if direction <= 0.0 and value - low > threshold:
                direction, low, high = 1.0, value, value
            elif direction >= 0.0 and high - value > threshold:
                direction, low, high = -1.0, value, value
            found[row, k] = direction
    return found


def alternative_readings(
    robot: Robot, measurements: Sequence[Measurement], forces: Array
) -> tuple[tuple[str, float, float], ...]:
    """Return interpretations of the rotations that fit much better: text, its mean error, mean error as given [m].

    The function tests reversed axes, and rotations in degrees instead of radians, each with a fit of the frames only.
    """
    some: list[int] = np.unique(
        np.linspace(0, len(measurements) - 1, min(ALTERNATIVE_SAMPLE_SIZE, len(measurements))).astype(int)
    ).tolist()
    measurements, forces = [measurements[k] for k in some], forces[some]
    joints = np.array([measurement.joints for measurement in measurements])
    turns = [k for k, joint in enumerate(robot.joints) if joint.motion == "rotation" and np.ptp(joints[:, k]) > 0.0]
    readings: list[tuple[str, Array]] = []
    for signs in itertools.product((1.0, -1.0), repeat=len(turns)):
        factor = np.ones(len(robot.joints))
        factor[turns] = signs
        if any(sign < 0.0 for sign in signs):
            names = " and ".join(robot.joints[k].name for k, s in zip(turns, signs, strict=True) if s < 0.0)
            handed = " (or tips in a left-handed frame)" if all(sign < 0.0 for sign in signs) else ""
            readings.append((f"{names} reversed{handed}", factor))
    if turns:
        factor = np.ones(len(robot.joints))
        factor[turns] = math.pi / 180.0
        readings.append(("all rotations read as degrees", factor))
    given = _mean_error(robot, measurements, forces, np.ones(len(robot.joints)))
    found = [(text, _mean_error(robot, measurements, forces, factor), given) for text, factor in readings]
    return tuple(
        sorted((each for each in found if each[1] < MAX_ALTERNATIVE_ERROR_RATIO * given), key=lambda each: each[1])
    )


def _mean_error(robot: Robot, measurements: Sequence[Measurement], forces: Array, factor: Array) -> float:
    """Return the mean error [m] of the best frames for joints times `factor` (n,); inf if there is no shape."""
    read = [measurement._replace(joints=measurement.joints * factor) for measurement in measurements]
    try:
        return ErrorStatistics.of(fit_poses(robot, read, forces, "frames", FitParameters()).errors(read, forces)).mean
    except CtrError:
        return math.inf


def _start_distances(robot: Robot, joints: Sequence[Array]) -> Array:
    """Return the smallest distance (q,) of each tube's proximal end from its neighbours' ends and the plate [m]."""
    starts = np.array([np.append(robot.tube_poses(pose)[1], 0.0) for pose in joints])
    apart = np.abs(np.diff(starts, axis=1)).min(axis=0)
    return np.minimum(np.append(math.inf, apart[:-1]), apart)
