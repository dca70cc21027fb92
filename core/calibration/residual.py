"""Residual of a calibration fit: its classification, and the learned residual that corrects the model.

A Gaussian process (`core.control.tip_residual`) predicts the residual at each pose from the residuals at other poses
(cross-validation). A part that joints and load predict is a smooth function; a part that only the direction states of
the previous motions predict is due to friction. The learned residual predicts both.

Friction twists a tube that turns inside another tube until it slips. The wind-up s of a tube [rad], by which its
rotation lags behind its base, follows Dahl's law with one parameter, the half lag h, which is the largest wind-up. A
rotation by d relative to the tube around it (for the outermost tube: relative to the tube inside it) changes s to

    s' = exp(-|d| / h) s + (1 - exp(-|d| / h)) h sign(d)

A long rotation therefore ends at s = +-h. From s = 0, a rotation much shorter than h does not move the tube's distal
end. The law ignores sliding. It assumes that joints turn monotonically from pose to pose.
"""

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from core.calibration.gaussian_process import condition, fit_kernel
from core.control.tip_residual import (
    DIRECTION,
    MAX_SUPPORT,
    TipResidual,
    advance_directions,
    inputs_of,
    residual_at,
    write_inputs,
)
from core.robot.robot import Array, Robot

#: Number of recent poses that form the path of a pose. Older motions have no noticeable effect, because each rotation
#: by d scales the earlier wind-up by exp(-|d| / h), where h is the half lag.
PATH_POSES = 17
#: Standard deviation of the prior of a tube's half lag (its largest wind-up) [rad].
EXPECTED_HALF_LAG_RAD = 0.1
#: Smallest half lag [rad]; it keeps the quotient |d| / h finite.
LEAST_HALF_LAG_RAD = 1e-6


class Windup(NamedTuple):
    """A tube whose wind-up is fitted, and the joint that turns it."""

    tube: int  #: index of the tube; 0 is the innermost
    joint: int  #: index of the joint that turns the tube


def paths(joints: Array) -> Array:
    """Return the path (m, p, n) of each pose: the last p poses up to it, for joints (m, n) ordered by time."""
    padded = np.concatenate((np.repeat(joints[:1], PATH_POSES - 1, axis=0), joints))
    return np.ascontiguousarray(sliding_window_view(padded, PATH_POSES, axis=0).transpose(0, 2, 1))


def turned_tubes(robot: Robot) -> tuple[Windup, ...]:
    """Return the tubes that a joint turns inside or around another tube, with this joint."""
    turns = [Windup(joint.tube, k) for k, joint in enumerate(robot.joints) if joint.motion == "rotation"]
    return tuple(turns) if len(robot.tubes) > 1 else ()


def relative_rotations(robot: Robot, joints: Array) -> Array:
    """Return the rotation (..., q) [rad] of each tube relative to its neighbour, at joints (..., n).

    The neighbour is the tube around it; for the outermost tube, the tube inside it.
    """
    alpha = np.zeros((*joints.shape[:-1], len(robot.tubes)))
    for k, joint in enumerate(robot.joints):
        if joint.motion == "rotation":
            alpha[..., joint.tube] = joints[..., k]
    neighbour = np.concatenate((alpha[..., 1:], alpha[..., -2:-1]), axis=-1)
    return alpha - neighbour


def wind_ups(robot: Robot, history: Array, half_lags: Array) -> Array:
    """Return the wind-up (m, q) at the ends of paths (m, p, n), for half lags (q,) [rad]."""
    steps = np.diff(relative_rotations(robot, history), axis=1)
    lag = np.maximum(half_lags, LEAST_HALF_LAG_RAD)
    wound = np.zeros((len(history), len(robot.tubes)))
    for step in steps.transpose(1, 0, 2):
        decay = np.exp(-np.abs(step) / lag)
        wound = decay * wound + (1.0 - decay) * lag * np.sign(step)
    return wound


#: The kind is `friction` or `smooth` only if its prediction explains more than this fraction of the squared error.
NAMED_PART = 0.1
#: Smallest number of poses for a classification or a fit of the residual.
MIN_POSES = 15
#: Largest number of poses for the classification; with more poses, only every k-th pose is used.
MAX_POSES = 400
FOLDS = 5
#: Smallest increase of the tip's error that switches a residual off [m].
MIN_TOLERANCE_M = 0.3e-3

Kind = Literal["friction", "smooth", "neither", "unknown"]


class Residual(NamedTuple):
    """Classified residual; fractions of the squared error are cross-validated, and negative for harmful predictions."""

    kind: Kind
    last_pose: float  #: correlation of an error with the error of the previous pose; NaN if the order is unknown
    smooth: float  #: fraction of the squared error that joints and load predict
    motion: float  #: fraction of the squared error that joints, load and motions predict; NaN if the order is unknown
    mean: float  #: mean length of the errors [m]
    learned: float  #: mean length of the errors after subtracting the better of the two predictions [m]


class PoseErrors(NamedTuple):
    """Errors of a model at m poses, and the quantities that predict them."""

    robot: Robot
    joints: Array  #: (m, n) [rad or m]
    directions: Array | None  #: (m, n) direction states; None: the order of the poses is unknown
    forces: Array  #: (m, 3) force at the tip, world frame [N]
    errors: Array  #: (m, 3) measured minus modelled tip, world frame [m]; NaN: not used
    trajectories: NDArray[np.int64]  #: (m,) trajectory to which each pose belongs

    def of(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "PoseErrors":
        """Return the poses of the given rows."""
        directions = None if self.directions is None else self.directions[rows]
        return self._replace(
            joints=self.joints[rows], directions=directions, forces=self.forces[rows], errors=self.errors[rows],
            trajectories=self.trajectories[rows],
        )  # fmt: skip

    @property
    def usable(self) -> "PoseErrors":
        """The poses whose errors are finite."""
        return self.of(np.flatnonzero(np.isfinite(self.errors).all(axis=1)))

    def folds(self) -> Iterator[NDArray[np.bool_]]:
        """Yield for each part the flags (m,) of its poses; each trajectory is in one part only."""
        names, number = np.unique(self.trajectories, return_inverse=True)
        for k in range(min(FOLDS, len(names))):
            yield number % FOLDS == k


def direction_states(robot: Robot, history: Array) -> Array:
    """Return the direction states (m, n) at the ends of paths (m, p, n), which start without direction."""
    table, found = inputs_of(robot).table, np.zeros((len(history), history.shape[2]))
    for path, state in zip(history, found, strict=True):
        for before, now in pairwise(path):
            advance_directions(table, before, now, state.copy(), state)
    return found


def fit_residual(poses: PoseErrors, *, directed: bool = True, strength: float | None = None) -> TipResidual | None:
    """Fit the residual; None if there are too few poses, or if it predicts nothing on held-out trajectories.

    Args:
        poses: errors of the model; rows with NaN are ignored.
        directed: whether the direction states are inputs, if they are known.
        strength: factor of the prediction. None: the factor that fits held-out trajectories best, at most 1.

    """
    poses, robot, tolerance = poses.usable, poses.robot, MIN_TOLERANCE_M
    if len(poses.joints) < MIN_POSES or not poses.errors.any():
        return None
    if strength is None:
        guess = predicted_by_others(poses, poses.folds())
        power, left = float(np.sum(guess**2)), np.linalg.norm(poses.errors - guess, axis=1)
        tolerance = max(MIN_TOLERANCE_M, float(np.percentile(left, 95.0)))
        strength = min(1.0, float(np.sum(guess * poses.errors)) / power) if power > 0.0 else 0.0
        if strength <= 0.0:
            return None
    inputs, base = inputs_of(robot), np.ascontiguousarray(robot.base.rotation)
    expected, table = inputs.expected.copy(), inputs.table
    if poses.directions is None or not directed:
        expected[inputs.groups[inputs.table[:, 0] == DIRECTION]] = math.inf
    directions = np.zeros_like(poses.joints) if poses.directions is None else poses.directions
    points = np.empty((len(poses.joints), len(table)))
    for row, point in enumerate(points):
        write_inputs(table, inputs.frame_joint, base, poses.joints[row], directions[row], poses.forces[row], point)
    turns = poses.joints[:, inputs.frame_joint] if inputs.frame_joint >= 0 else np.zeros(len(points))
    errors, c, s = poses.errors @ base, np.cos(turns), np.sin(turns)
    local = np.column_stack((c * errors[:, 0] + s * errors[:, 1], c * errors[:, 1] - s * errors[:, 0], errors[:, 2]))
    kernel = fit_kernel(points, local, inputs.groups, expected)
    return TipResidual(inputs, base, kernel.scales, *condition(kernel, points, local, MAX_SUPPORT), strength, tolerance)


def predict_residual(found: TipResidual | None, poses: PoseErrors) -> tuple[Array, Array]:
    """Return the residual (m, 3) [m] at poses, and the explained shares of its variance (m,); None: zeros."""
    values, shares = np.zeros((len(poses.joints), 3)), np.zeros(len(poses.joints))
    if found is None:
        return values, shares
    packed, n = found.packed(), poses.joints.shape[1]
    directions = np.zeros_like(poses.joints) if poses.directions is None else poses.directions
    jacobian, by_force = np.empty((3, n)), np.empty((3, 3))
    for k, value in enumerate(values):
        at = poses.joints[k], directions[k], poses.forces[k]
        shares[k] = residual_at(packed, *at, value, jacobian, by_force)
    return values, shares


def predicted_by_others(poses: PoseErrors, folds: Iterable[NDArray[np.bool_]], *, directed: bool = True) -> Array:
    """Return the residual (m, 3) [m] of the poses of each part, predicted from all other parts."""
    found = np.zeros_like(poses.errors)
    for test in folds:
        fitted = fit_residual(poses.of(~test), directed=directed, strength=1.0)
        found[test] = predict_residual(fitted, poses.of(test))[0]
    return found


def residual(poses: PoseErrors) -> Residual:
    """Classify the errors at poses that are ordered by time if their direction states are known."""
    poses = poses.usable
    order, some = poses.errors, poses.of(np.arange(0, len(poses.errors), max(1, -(-len(poses.errors) // MAX_POSES))))
    errors = some.errors
    centred = errors - errors.mean(axis=0) if len(errors) else errors
    power, mean = float(np.sum(centred**2)), float(np.linalg.norm(errors, axis=1).mean()) if len(errors) else math.nan
    if len(errors) < MIN_POSES or power == 0.0:
        return Residual("unknown", math.nan, math.nan, math.nan, mean, mean)
    last_pose = math.nan if poses.directions is None else float(np.sum(order[1:] * order[:-1]) / np.sum(order * order))
    fold: NDArray[np.int64] = np.random.default_rng(0).permutation(len(errors)) % FOLDS
    predictions = [
        predicted_by_others(some._replace(errors=centred), [fold == k for k in range(FOLDS)], directed=directed)
        for directed in ((False,) if poses.directions is None else (False, True))
    ]
    parts = [1.0 - float(np.sum((centred - guess) ** 2)) / power for guess in predictions]
    smooth, motion = parts[0], parts[1] if len(parts) > 1 else math.nan
    best = predictions[int(np.argmax(parts))] if max(parts) > 0.0 else np.zeros_like(centred)
    learned = float(np.linalg.norm(centred - best, axis=1).mean())
    kind: Kind = "neither"
    if motion - max(smooth, 0.0) > NAMED_PART:
        kind = "friction"
    elif smooth > NAMED_PART:
        kind = "smooth"
    return Residual(kind, last_pose, smooth, motion, mean, min(learned, mean))
