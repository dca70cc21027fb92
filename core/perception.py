"""From a sample to an estimate in one compiled call: fuse the wrenches, solve both models, estimate.

Each of these is a function of its own elsewhere; here they share one way into compiled code and back,
which costs as much as the arithmetic.
"""

import math
from typing import NamedTuple

import numpy as np

from core.actuation import Motion
from core.compiled import compiled
from core.estimation import Estimate, Estimator, estimate
from core.newton import newton
from core.observer import Observed
from core.robot import Array, unpack
from core.solution import Solution
from core.statics import Statics
from core.wrench import Fused, fuse_at, fused_at


class Perceived(NamedTuple):
    """What a sample tells."""

    load: Fused
    estimate: Estimate


def perceive(
    statics: Statics, estimator: Estimator, last: Estimate,
    joints: Array, wrenches: Array, sent: Array, tip: Array | None, age: float,
) -> Perceived:  # fmt: skip
    """One tick on.

    Args:
        statics: the model.
        estimator: its filters.
        last: the estimate of the tick before.
        joints: (n,) measured [rad or m].
        wrenches: (q, 6) tared, each in its sensor's axes [N, N m].
        sent: (n,) velocities that went out to the stages last [rad/s or m/s].
        tip, age: a tracker frame that has just arrived (3,) [m] and the time since it was measured [s].

    Raises:
        PoseError, NoSolution: the model cannot follow the measured pose and load.
        NotFinite: the measured load is not finite.

    """
    observer, actuation, seen, motion = estimator.observer, estimator.actuation, last.observed, last.motion
    state, tips = seen.state.copy(), seen.tips.copy()
    packed, order, sublink, tubes, columns = statics.compiled_arguments
    load, loaded, unloaded, vectors, moved, ahead, place, used = _perceive(
        packed, order, sublink, tubes, columns, joints, wrenches,
        last.loaded.numbers, last.unloaded.numbers, last.vectors,
        estimator.filter.period, estimator.filter.gain[0], estimator.filter.gain[1],
        0.5 * actuation.hold, actuation.lead, motion.sent, sent,
        state, tips, seen.place, sent if tip is None else tip, -1.0 if tip is None else age,
        observer.noise**2, observer.wander, observer.gate,
    )  # fmt: skip
    if place < 0:  # a model needs more than the warm start
        return _carefully(statics, estimator, last, joints, wrenches, sent, tip, age)
    places = last.loaded.places
    return Perceived(
        Fused(load[:3], load[3:]),
        Estimate(
            Solution(loaded, places), Solution(unloaded, places), vectors,
            Motion(moved, ahead), Observed(state, tips, place, used),
        ),
    )  # fmt: skip


def point_force(load: Fused) -> Array:
    """The measured load taken as a force at the tip (6,), as the paper does: its moment is redundant."""
    wrench = np.zeros(6)
    wrench[:3] = load.force
    return wrench


def _carefully(
    statics: Statics, estimator: Estimator, last: Estimate,
    joints: Array, wrenches: Array, sent: Array, tip: Array | None, age: float,
) -> Perceived:  # fmt: skip
    load = fuse_at(statics.robot, joints, wrenches)
    loaded = statics.solve(joints, point_force(load), last.loaded)
    unloaded = statics.solve(joints, np.zeros(6), last.unloaded)
    return Perceived(load, estimator.update(last, loaded, unloaded, load.force, sent, tip, age))


@compiled
def _perceive(
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...],
    joints: Array, wrenches: Array, near_loaded: Array, near_unloaded: Array, old: Array,
    period: float, k_value: float, k_rate: float, wait: float, lead: float, sent: Array, sent_now: Array,
    state: Array, tips: Array, place: int, frame: Array, age: float, noise: float, wander: float, gate: float,
) -> tuple[Array, Array, Array, Array, Array, Array, int, bool]:  # fmt: skip
    """`perceive`; the place is -1 when a model was not solved, and nothing else counts then."""
    load = fused_at(unpack(packed), joints, wrenches)
    wrench, nothing = np.zeros(6), np.zeros(6)
    wrench[:3] = load[:3]
    loaded = newton(packed, order, sublink, joints, wrench, near_loaded, math.inf, 1, tubes, columns)
    unloaded = newton(packed, order, sublink, joints, nothing, near_unloaded, math.inf, 1, tubes, columns)
    if not (loaded[-1] > 0.0 and unloaded[-1] > 0.0):
        return load, loaded, unloaded, old, sent, nothing, -1, False
    new, moved, ahead, place, used = estimate(
        period, k_value, k_rate, wait, lead, len(tubes), joints.shape[0], loaded, unloaded,
        near_loaded, near_unloaded, old, load[:3], sent, sent_now,
        state, tips, place, frame, age, noise, wander, gate,
    )  # fmt: skip
    return load, loaded, unloaded, new, moved, ahead, place, used
