"""Poses that were measured anywhere, held against the model: as described, with the best frames, with the best tubes.

The fit is that of `prediction`, with these differences. How well the points were measured is not asked for: what a
fit leaves over is taken as the standard deviation of each axis, and the fit repeated until both agree, so that what
is known beforehand weighs as much as it should where the model itself is wrong. Where neighbouring poses are wrong
alike (`alike`) they count as fewer. Single poses far from all others' errors are not fitted: tubes that snapped to
another shape, slips of the measurement. The point on the tip may be centimetres from it. And a joint may stay behind
the way that it came by much more than a drive's play: friction between the tubes winds them up.

Only what the poses can say is asked for (`askable`); what of it they do not tell is in the fit's account.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.calibration.fit import Fit, Parameter, Unobservable, fit
from core.calibration.measurements import Measurement, Noise
from core.calibration.prediction import Frames, Lag, NoShape, Prediction, predicted
from core.calibration.quantities import Quantity, quantities
from core.calibration.registration import closed_form
from core.calibration.rigid import Rigid, cross_matrix
from core.calibration.tubes import LEAST_LOADED
from core.errors import CtrError
from core.robot.robot import Array, Robot

Extent = Literal["none", "frames", "tubes"]

#: How far from the tip the measured point may be, one standard deviation of each axis [m].
OFFSET = 0.030
#: Lag that is expected beforehand, one standard deviation [rad, m].
LAG = {"rad": 0.05, "m": 1e-3}
#: Standard deviation of a measured point where the repetition begins, and what it never goes below [m].
NOISE, LEAST_NOISE = 0.5e-3, 1e-6
#: Repetitions, and the part by which the last may still differ.
ROUNDS, SETTLED = 8, 0.05
#: Neighbours are never taken to be more alike than this.
MOST_ALIKE = 0.9
#: Poses off by more than this many times the median are not fitted, as long as they are no more than that part.
FAR, FEW = 4.0, 0.1
#: A load below does not count as one [N].
LOADED = 0.05
#: A tube's end must be this far from its neighbours' for its length, or its lag, to be asked for [m].
ROOM = 1.5e-3
#: A joint that turns back by less than this part of its whole way has not turned back.
TURN = 2e-3
#: An alternative reading of the joints is named when it leaves less than this part of the error.
BETTER = 0.5
#: Poses that alternatives are tried on.
TRIED = 200


class Asked(NamedTuple):
    """What a fit to measured poses asks for."""

    quantities: tuple[Quantity, ...] = ()
    lags: tuple[Lag, ...] = ()
    left: tuple[str, ...] = ()  #: what it does not ask for, and why


class Spread(NamedTuple):
    """Distances of measured points from the model's [m]."""

    poses: int
    mean: float
    median: float
    p95: float
    largest: float

    @classmethod
    def of(cls, errors: Array) -> "Spread":
        """Of errors (m, 3) [m]; rows of NaN do not count, and without any other all is NaN but the number."""
        lengths = np.linalg.norm(errors[np.isfinite(errors).all(axis=1)], axis=1)
        if not lengths.size:
            return cls(0, math.nan, math.nan, math.nan, math.nan)
        p50, p95 = np.percentile(lengths, (50.0, 95.0)).tolist()
        return cls(len(lengths), float(lengths.mean()), p50, p95, float(lengths.max()))


@dataclass(frozen=True)
class Match:
    """The model brought as near to the poses as its extent allows."""

    extent: Extent
    robot: Robot
    frames: Frames
    plays: Array  #: (n,) [rad or m]
    noise: float  #: standard deviation of each axis that is left [m]
    alike: float  #: correlation of the errors of neighbouring poses, 0 ... `MOST_ALIKE`
    asked: Asked
    fit: Fit | None  #: None: nothing was fitted
    fitted: tuple[bool, ...]  #: which of the poses the fit saw
    middle: Array  #: (3,) about which the fit turned the points, robot's frame [m]

    def errors(self, measurements: Sequence[Measurement], forces: Array) -> Array:
        """Measured minus predicted point (m, 3), robot's frame [m], of any poses under tip forces (m, 3) [N].

        NaN where this model has no shape.
        """
        return _errors(self.robot, self.frames, self.plays, measurements, forces)

    @property
    def position_errors(self) -> Array:
        """Standard deviations (3,) of the registration's position [m].

        The fit's own are those of the middle of the points. What stands far from there, as the origin of the points'
        frame may, also moves by the error of the rotation.
        """
        if self.fit is None:
            return np.zeros(3)
        first = [parameter.name for parameter in self.fit.parameters].index("frame rotation x")
        covariance = self.fit.covariance[first : first + 6, first : first + 6]
        carry = np.hstack((-cross_matrix(self.frames.registration.position - self.middle), np.eye(3)))
        return np.sqrt(np.diag(carry @ covariance @ carry.T))

    @property
    def lost(self) -> frozenset[str]:
        """Parameters of which the poses say nothing and nothing was known beforehand."""
        weak = () if self.fit is None else self.fit.weak
        return frozenset(name for each in weak if math.isinf(each.open) and not each.held for name, _ in each.parts)

    @property
    def surprising(self) -> tuple[tuple[Parameter, float], ...]:
        """What came out more than two standard deviations from what was known beforehand, and where [unit of it]."""
        if self.fit is None:
            return ()
        values: list[float] = self.fit.values.tolist()
        pairs = zip(self.fit.parameters, values, strict=True)
        return tuple((parameter, value) for parameter, value in pairs if abs(value) > 2.0 * parameter.prior)

    @property
    def held(self) -> tuple[str, ...]:
        """Of what the poses tell less than was known beforehand: the data shrink the variance by less than half."""
        if self.fit is None:
            return ()
        errors: list[float] = self.fit.errors.tolist()
        pairs = zip(self.fit.parameters, errors, strict=True)
        return tuple(parameter.name for parameter, error in pairs if error * error > 0.5 * parameter.prior**2)


def match(robot: Robot, measurements: Sequence[Measurement], forces: Array, extent: Extent, asked: Asked) -> Match:
    """Bring the model as near to poses under tip forces (m, 3) [N] as `extent` allows.

    Args:
        robot: as described.
        measurements: poses; `coil` is the measured point.
        forces: world frame.
        extent: `none` takes the points as they are, in the robot's frame, at the tip; `frames` finds a rigid
            motion and where the point sits in the frame of the tip; `tubes` finds the tubes with them.
        asked: of `askable`; its lags count from `frames` on, its quantities for `tubes`.

    Raises:
        Unobservable: fewer poses than unknowns.
        CtrError: the model has no shape at a pose.

    """
    if extent == "none":
        frames = Frames(Rigid(np.eye(3), np.zeros(3)), np.zeros(3), np.zeros(3))
        nothing = (False,) * len(measurements)
        return Match(extent, robot, frames, np.zeros(len(robot.joints)), 0.0, 0.0, Asked(), None, nothing, np.zeros(3))
    what = asked.quantities if extent == "tubes" else ()
    unknown = len(what) + len(asked.lags) + 9
    if 3 * len(measurements) < unknown + 3:
        raise Unobservable(
            f"usable poses: {len(measurements)}, for {unknown} unknowns ({extent});"
            f" at least {unknown // 3 + 1} are needed"
        )
    start, noise, values = closed_form(robot, measurements, forces), NOISE, None
    joints, lost = np.array([measurement.joints for measurement in measurements]), np.zeros(len(measurements), bool)
    kept, most, rounds = ~lost, max(1, int(FEW * len(measurements))), 0
    while True:
        seen: list[int] = np.flatnonzero(kept).tolist()
        near = [measurements[k] for k in seen]
        problem = Prediction(robot, what, near, forces[kept], Noise(coil=noise), start, OFFSET, asked.lags)
        try:
            found = fit(problem, problem.parameters, values)
        except NoShape as error:
            # Beside a fold the smallest change of the tubes leaves no shape: such a pose tells nothing of them.
            lost[seen[error.measurement]] = True
            kept = kept & ~lost
            if np.count_nonzero(lost) > most:
                raise
            continue
        values, rounds = found.values, rounds + 1
        tubes, frames, plays = problem.tubes(values), problem.frames(values), problem.plays(values)
        errors = _errors(tubes, frames, plays, measurements, forces)
        left = max(noise * math.sqrt(found.variance_factor), LEAST_NOISE)
        correlation = alike(joints[kept], errors[kept])
        before, noise = noise, left * math.sqrt((1.0 + correlation) / (1.0 - correlation))
        fitted, kept = kept, _near(errors, most) & ~lost
        if rounds == ROUNDS or (abs(noise - before) <= SETTLED * before and (kept == fitted).all()):
            own = asked._replace(quantities=what)
            saw = tuple(fitted.tolist())
            return Match(extent, tubes, frames, plays, left, correlation, own, found, saw, problem.middle)


def _near(errors: Array, most: int) -> NDArray[np.bool_]:
    """Which errors (m, 3) are no more than `FAR` times the median; all when more than `most` were left out."""
    lengths = np.linalg.norm(errors, axis=1)
    near = lengths <= FAR * float(np.nanmedian(lengths))
    return near if np.count_nonzero(~near) <= most else np.isfinite(lengths)


def _errors(robot: Robot, frames: Frames, plays: Array, measurements: Sequence[Measurement], forces: Array) -> Array:
    """Measured minus predicted point (m, 3), robot's frame [m]; NaN where the model has no shape."""
    solved = predicted(robot, measurements, forces, plays)
    points = np.array([measurement.coil for measurement in measurements])
    return frames.registration.apply(points) - solved.tip - solved.rotation @ frames.coil


def alike(joints: Array, errors: Array) -> float:
    """Correlation of errors (m, 3) with those at the nearest other joints (m, n), 0 ... `MOST_ALIKE`.

    Noise of a measurement is none; what a model does not know goes on from one pose to the next. With correlation r
    m errors in a row say as much as m (1 - r) / (1 + r) that are independent.
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
    return float(np.clip(np.sum(errors * errors[nearest]) / power, 0.0, MOST_ALIKE))


def askable(
    robot: Robot,
    measurements: Sequence[Measurement],
    forces: Array,
    *,
    hysteresis: bool,
    others: Sequence[Measurement] = (),
) -> Asked:
    """What poses under tip forces (m, 3) [N] can be asked for, so that `others` can be predicted, too.

    Without load only ratios of stiffness show: then the outermost tube's stays as described. A tube that stands flush
    with a neighbour in some pose could not be made shorter, or lag, in that pose.
    """
    kept: list[Quantity] = []
    lags: list[Lag] = []
    left: list[str] = []
    loaded = int(np.count_nonzero(np.linalg.norm(forces, axis=1) > LOADED))
    rooms = _rooms(robot, (*measurements, *others))
    for quantity in quantities(robot):
        if quantity.kind == "end":
            continue  # held by few poses, and nobody else's model has it
        name = quantity.parameter(robot).name.replace("_", " ")
        if quantity.kind == "bending_stiffness" and quantity.tube == len(robot.tubes) - 1 and loaded < LEAST_LOADED:
            left.append(
                f"{name}: {loaded} poses under more than {LOADED:g} N; without load only ratios of stiffness show,"
                " so that the outermost tube's stays as described"
            )
        elif quantity.kind == "straight_length" and rooms[quantity.tube] < ROOM:
            left.append(f"{name}: in some pose the tube's end is within {1e3 * ROOM:g} mm of its neighbour's")
        else:
            kept.append(quantity)
    for k, joint in enumerate(robot.joints) if hysteresis else ():
        came = np.array([0.0 if measurement.came is None else measurement.came[k] for measurement in measurements])
        if not ((came > 0.0).any() and (came < 0.0).any()):
            left.append(f"lag of {joint.name}: it never came from both sides")
        elif joint.motion == "translation" and rooms[joint.tube] < ROOM:
            left.append(
                f"lag of {joint.name}: in some pose the tube is within {1e3 * ROOM:g} mm of its neighbour's end"
            )
        else:
            lags.append(Lag(k, LAG[joint.unit]))
    return Asked(tuple(kept), tuple(lags), tuple(left))


def ways(joints: Array) -> Array:
    """Which way each joint came, -1, 0 (not moved yet) or 1, of joints (m, n) in their order: (m, n)."""
    found = np.zeros_like(joints)
    for k, column in enumerate(joints.T):
        threshold = max(TURN * float(np.ptp(column)), 1e-9)
        way, low, high = 0.0, column[0], column[0]
        for row, value in enumerate(column.tolist()):
            # Since the last turn: the least and the largest value; back from the farthest of them is a turn.
            low, high = min(low, value), max(high, value)
            if way <= 0.0 and value - low > threshold:
                way, low, high = 1.0, value, value
            elif way >= 0.0 and high - value > threshold:
                way, low, high = -1.0, value, value
            found[row, k] = way
    return found


def suspicions(
    robot: Robot, measurements: Sequence[Measurement], forces: Array
) -> tuple[tuple[str, float, float], ...]:
    """Other readings of the rotations with which the poses fit much better: what, and mean error with and without [m].

    Axes that run the other way, and degrees that were meant as radians; with the frames alone fitted.
    """
    some: list[int] = np.unique(
        np.linspace(0, len(measurements) - 1, min(TRIED, len(measurements))).astype(int)
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
            readings.append((f"{names} running the other way{handed}", factor))
    if turns:
        factor = np.ones(len(robot.joints))
        factor[turns] = math.pi / 180.0
        readings.append(("all rotations read as degrees", factor))
    given = _mean_error(robot, measurements, forces, np.ones(len(robot.joints)))
    found = [(text, _mean_error(robot, measurements, forces, factor), given) for text, factor in readings]
    return tuple(sorted((each for each in found if each[1] < BETTER * given), key=lambda each: each[1]))


def _mean_error(robot: Robot, measurements: Sequence[Measurement], forces: Array, factor: Array) -> float:
    """What the best frames leave where every joint is read as `factor` (n,) of itself [m]; inf without any shape."""
    read = [measurement._replace(joints=measurement.joints * factor) for measurement in measurements]
    try:
        return Spread.of(match(robot, read, forces, "frames", Asked()).errors(read, forces)).mean
    except CtrError:
        return math.inf


def _rooms(robot: Robot, measurements: Sequence[Measurement]) -> Array:
    """Least distance (q,) of each tube's ends from those of its neighbours, over all measurements [m]."""
    least = np.full(len(robot.tubes), math.inf)
    lengths = np.array([tube.length for tube in robot.tubes])
    for measurement in measurements:
        _, beta = robot.tube_poses(measurement.joints)
        ends = np.minimum(np.abs(np.diff(beta + lengths)), _apart(np.abs(np.diff(beta)), robot))
        least[:-1], least[1:] = np.minimum(least[:-1], ends), np.minimum(least[1:], ends)
    return least


def _apart(starts: Array, robot: Robot) -> Array:
    """Of neighbours that no joint slides the proximal ends do not matter."""
    slides = {joint.tube for joint in robot.joints if joint.motion == "translation"}
    fixed = [i not in slides and i + 1 not in slides for i in range(len(starts))]
    return np.where(fixed, math.inf, starts)
