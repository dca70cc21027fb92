"""From a sample to an estimate in one compiled call: fuse the wrenches, solve both models, estimate.

Each of these is a function of its own elsewhere; here they share one way into compiled code and back,
which costs as much as the arithmetic.
"""

import math
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.estimation import Estimate, Estimator, estimate
from core.control.force_fusion import Fused, fuse_at, fused_at
from core.model.newton import CLOSE_ENOUGH, newton
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, unpack


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
    packed, order, sublink, tubes, columns = statics.compiled_arguments
    places, numbers = last.loaded.places, np.empty(last.places.total)
    load, loaded, unloaded = np.empty(6), np.empty(places.total), np.empty(places.total)
    if not _perceive(
        packed, order, sublink, tubes, columns, estimator.settings,
        joints, wrenches, sent, sent if tip is None else tip, -1.0 if tip is None else age,
        last.loaded.numbers, last.unloaded.numbers, last.numbers, places.q, 1, load, loaded, unloaded, numbers,
    ):  # fmt: skip
        # A model needs more than the warm start.
        return _carefully(statics, estimator, last, joints, wrenches, sent, tip, age)
    now = Estimate(Solution(loaded, places), Solution(unloaded, places), numbers, last.places)
    return Perceived(Fused(load[:3], load[3:]), now)


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
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], settings: Array,
    joints: Array, wrenches: Array, sent: Array, frame: Array, age: float,
    near_loaded: Array, near_unloaded: Array, last: Array, q: int, careful: int,
    load: Array, loaded: Array, unloaded: Array, now: Array,
) -> bool:  # fmt: skip
    """`perceive`, into the last four; False when a model was not solved, and nothing else counts then.

    `q` and `careful` are always the same, but a constant in here would have the compiler make a second Newton for it.
    """
    copy(fused_at(unpack(packed), joints, wrenches), load)
    wrench, nothing, tip, close = np.zeros(6), np.zeros(6), math.inf, CLOSE_ENOUGH
    copy(load[:3], wrench)
    copy(newton(packed, order, sublink, joints, wrench, near_loaded, tip, careful, close, tubes, columns), loaded)
    copy(newton(packed, order, sublink, joints, nothing, near_unloaded, tip, careful, close, tubes, columns), unloaded)
    if not (loaded[-1] > 0.0 and unloaded[-1] > 0.0):
        return False
    numbers = estimate(settings, q, loaded, unloaded, near_loaded, near_unloaded, last, load[:3], sent, frame, age)
    copy(numbers, now)
    return True
