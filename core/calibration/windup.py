"""Torsional wind-up by friction: how far each tube's rotation lags behind its base, from the sequence of motions.

Friction twists a tube that turns inside another tube until it slips. The wind-up s of a tube [rad] follows Dahl's law
with one parameter, the half lag h, which is the largest wind-up. A rotation by d relative to the tube around it (for
the outermost tube: relative to the tube inside it) changes s to

    s' = exp(-|d| / h) s + (1 - exp(-|d| / h)) h sign(d)

A long rotation therefore ends at s = +-h. From s = 0, a rotation much shorter than h does not move the tube's distal
end. The law ignores sliding. It assumes that joints turn monotonically from pose to pose.
"""

from typing import NamedTuple

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
