"""sample -> estimate, in one compiled call: fuse the wrenches, solve both models, estimate."""

import math
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.estimation import Estimate, Estimator, estimate
from core.control.force_fusion import Fused, fused_at
from core.model.newton import CLOSE_ENOUGH, newton
from core.model.solution import Solution, pure_force
from core.model.statics import Statics
from core.robot.robot import Array, unpack

_NO_LOAD = np.zeros(6)


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
    frame, age = (sent, -1.0) if tip is None else (tip, age)
    before = (last.loaded.numbers, last.unloaded.numbers, last.numbers)
    loaded, unloaded, numbers, total = *map(np.empty, map(len, before)), np.empty(6)
    load, now = Fused(total[:3], total[3:]), Estimate(Solution(loaded), Solution(unloaded), numbers)
    if not _perceive(
        *statics.compiled_arguments, estimator.settings, joints, wrenches, sent, frame, age, *before, 1,
        total, loaded, unloaded, numbers,
    ):  # fmt: skip
        # A model needs more than the warm start: in steps, or from the beginning.
        # The load is taken as a force at the tip, as the paper does: its moment is redundant.
        now.loaded = statics.solve(joints, pure_force(load.force), last.loaded)
        now.unloaded = statics.solve(joints, _NO_LOAD, last.unloaded)
        estimate(
            estimator.settings, now.loaded.numbers, now.unloaded.numbers, *before,
            load.force, sent, frame, age, numbers,
        )  # fmt: skip
    return Perceived(load, now)


@compiled
def _perceive(
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], settings: Array,
    joints: Array, wrenches: Array, sent: Array, frame: Array, age: float,
    near_loaded: Array, near_unloaded: Array, last: Array, careful: int,
    load: Array, loaded: Array, unloaded: Array, now: Array,
) -> bool:  # fmt: skip
    """`perceive`, into the last four; False when a model was not solved, and only the load counts then.

    `careful` is always 1, but a constant in here would have the compiler make a second Newton for it.
    """
    copy(fused_at(unpack(packed), joints, wrenches), load)
    wrench, nothing, tip, close = np.zeros(6), np.zeros(6), math.inf, CLOSE_ENOUGH
    copy(load[:3], wrench)
    if not (
        newton(packed, order, sublink, joints, wrench, near_loaded, tip, careful, close, tubes, columns, loaded)
        and newton(
            packed, order, sublink, joints, nothing, near_unloaded, tip, careful, close, tubes, columns, unloaded
        )
    ):
        return False
    estimate(settings, loaded, unloaded, near_loaded, near_unloaded, last, load[:3], sent, frame, age, now)
    return True
