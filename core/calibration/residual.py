"""Classification of a calibration fit's residual: friction, a smooth function of the joints, or neither.

Kernel ridge regression predicts the residual at each pose from the residuals at other poses (cross-validation). The
inputs of the regression are the joint positions alone, or the joint positions and each tube's wind-up from the previous
motions (`wind_ups`). A part of the residual that the joint positions predict is a smooth function, and a learned
correction could remove it. A part that only the previous motions predict is due to friction.

Friction twists a tube that turns inside another tube until it slips. The wind-up s of a tube [rad], by which its
rotation lags behind its base, follows Dahl's law with one parameter, the half lag h, which is the largest wind-up. A
rotation by d relative to the tube around it (for the outermost tube: relative to the tube inside it) changes s to

    s' = exp(-|d| / h) s + (1 - exp(-|d| / h)) h sign(d)

A long rotation therefore ends at s = +-h. From s = 0, a rotation much shorter than h does not move the tube's distal
end. The law ignores sliding. It assumes that joints turn monotonically from pose to pose.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

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

    tube: int  #: 0 = innermost
    joint: int  #: index of the joint that turns the tube


def paths(joints: Array) -> Array:
    """Return the path (m, p, n) of each pose: the last p poses up to it, for joints (m, n) ordered by time."""
    padded = np.concatenate((np.repeat(joints[:1], PATH_POSES - 1, axis=0), joints))
    return np.ascontiguousarray(sliding_window_view(padded, PATH_POSES, axis=0).transpose(0, 2, 1))


def turned_tubes(robot: Robot) -> tuple[Windup, ...]:
    """Return the tubes that a joint turns in or around another tube."""
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


Kind = Literal["friction", "smooth", "neither", "unknown"]

#: The kind is `friction` or `smooth` only if its prediction explains more than this fraction of the squared error.
NAMED_PART = 0.1
#: Smallest number of poses for a classification of the residual.
MIN_POSES = 15
#: Largest number of poses in the regression; larger sets are subsampled, since the cost grows with the number's cube.
MAX_POSES = 400
FOLDS = 5
#: Kernel widths that the regression tests, in standard deviations of the inputs, and ridges, as fractions of the
#: variance.
WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
RIDGES = (1e-3, 1e-2, 1e-1, 1.0)
#: Half lag of the wind-up that represents the direction of the last motion [rad].
DIRECTION_HALF_LAG_RAD = 0.05


class Residual(NamedTuple):
    """Classified residual; fractions of the squared error are cross-validated, and negative for harmful predictions."""

    kind: Kind
    last_pose: float  #: correlation of an error with the error of the previous pose; NaN if the order is unknown
    smooth: float  #: fraction of the squared error that the joints predict
    motion: float  #: fraction of the squared error that joints and motions predict; NaN if the order is unknown
    mean: float  #: mean length of the errors [m]
    learned: float  #: mean length of the errors after subtracting the better of the two predictions [m]


def residual(
    robot: Robot, joints: Array, errors: Array, history: Array | None, windups: tuple[Windup, ...]
) -> Residual:
    """Classify errors (m, 3) [m] at joints (m, n), reached along paths (m, p, n) if their order is known.

    Rows with NaN are ignored.
    """
    usable = np.flatnonzero(np.isfinite(errors).all(axis=1))
    order = errors[usable]
    some = usable[:: -(-len(usable) // MAX_POSES)] if len(usable) else usable
    joints, errors = joints[some], errors[some]
    centred = errors - errors.mean(axis=0) if len(some) else errors
    power, mean = float(np.sum(centred**2)), float(np.linalg.norm(errors, axis=1).mean()) if len(some) else math.nan
    if len(some) < MIN_POSES or power == 0.0:
        return Residual("unknown", math.nan, math.nan, math.nan, mean, mean)
    last_pose = math.nan if history is None else float(np.sum(order[1:] * order[:-1]) / np.sum(order * order))
    where = np.concatenate((np.cos(joints), np.sin(joints)), axis=1)
    slides = np.array([joint.motion == "translation" for joint in robot.joints])
    where[:, np.flatnonzero(slides)] = joints[:, slides]
    where = where[:, np.ptp(where, axis=0) > 1e-12]
    predictions = [_predicted(where, centred)]
    if history is not None and windups:
        lags = np.full(len(robot.tubes), DIRECTION_HALF_LAG_RAD)
        wound = wind_ups(robot, history[some], lags)[:, [each.tube for each in windups]] / DIRECTION_HALF_LAG_RAD
        predictions.append(_predicted(where, centred, wound))
    parts = [1.0 - float(np.sum((centred - guess) ** 2)) / power for guess in predictions]
    smooth, motion = parts[0], parts[1] if len(parts) > 1 else math.nan
    best = predictions[int(np.argmax(parts))] if max(parts) > 0.0 else np.zeros_like(centred)
    learned = float(np.linalg.norm(errors - errors.mean(axis=0) - best, axis=1).mean())
    kind: Kind = "neither"
    if motion - max(smooth, 0.0) > NAMED_PART:
        kind = "friction"
    elif smooth > NAMED_PART:
        kind = "smooth"
    return Residual(kind, last_pose, smooth, motion, mean, min(learned, mean))


def _predicted(where: Array, errors: Array, wound: Array | None = None) -> Array:
    """Return each error (m, 3) predicted from the others, with the best width and ridge.

    With wind-ups (m, w) the kernel is k(where) (1 + sum of products of wind-ups). An error is then a smooth function of
    the joints plus wind-ups times other smooth functions.
    """
    scaled = (where - where.mean(axis=0)) / where.std(axis=0)
    apart = np.sum((scaled[:, None] - scaled[None]) ** 2, axis=2) / scaled.shape[1]
    gain = 1.0 if wound is None else 1.0 + wound @ wound.T
    fold = np.random.default_rng(0).permutation(len(errors)) % FOLDS
    best, least = np.zeros_like(errors), math.inf
    for width in WIDTHS:
        kernel = np.exp(-0.5 * apart / width**2) * gain
        for ridge in RIDGES:
            guess = np.empty_like(errors)
            for k in range(FOLDS):
                test = fold == k
                inner = kernel[np.ix_(~test, ~test)] + ridge * np.eye(int(np.count_nonzero(~test)))
                guess[test] = kernel[np.ix_(test, ~test)] @ np.linalg.solve(inner, errors[~test])
            left = float(np.sum((errors - guess) ** 2))
            if left < least:
                best, least = guess, left
    return best
