"""First half of a tick: turn a sample of the devices into an estimate, in one compiled call.

The steps are: sum the base wrenches, solve the model with and without load, and compute the estimates.
"""

import math
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.estimation import Estimate, Estimator, estimate, estimate_fields
from core.control.force_fusion import FusedLoad, fused_at
from core.control.tip_force import FORCE, estimate_force
from core.model.newton import CONTROL_STEP_RAD, newton
from core.model.solution import Solution, fields, pure_force
from core.model.statics import Statics
from core.robot.robot import Array, unpack

_NO_LOAD = np.zeros(6)


class Perception(NamedTuple):
    """Load and estimate computed from one sample of the devices."""

    load: FusedLoad
    estimate: Estimate


def perceive(
    statics: Statics, estimator: Estimator, last: Estimate,
    joints: Array, wrenches: Array, sent: Array, tip: Array | None, age: float,
) -> Perception:  # fmt: skip
    """Return load and estimate of one tick from the devices' readings.

    Args:
        statics: model of the robot.
        estimator: filters of the controller.
        last: estimate of the previous tick.
        joints: measured joint positions (n,) [rad or m].
        wrenches: tared wrenches of the base sensors (q, 6), each in the axes of its sensor [N, N m].
        sent: joint velocities (n,) sent to the stages last [rad/s or m/s].
        tip, age: tip (3,) in a new tracker frame [m], and the frame's age since its measurement [s]; tip None: no new
            frame.

    Raises:
        PoseError, NoSolution: the model has no shape at the measured pose and load.
        NotFinite: the measured load is not finite.

    """
    frame, age = (sent, -1.0) if tip is None else (tip, age)
    before = (last.loaded.numbers, last.unloaded.numbers, last.numbers)
    loaded, unloaded, numbers, total = *map(np.empty, map(len, before)), np.empty(6)
    load, now = FusedLoad(total[:3], total[3:]), Estimate(Solution(loaded), Solution(unloaded), numbers)
    if not _perceive(
        *statics.compiled_arguments, estimator.settings, estimator.load.settings,
        joints, wrenches, sent, frame, age, *before, 1,
        total, loaded, unloaded, numbers,
    ):  # fmt: skip
        # The warm start did not converge: `Statics.solve` follows the branch in smaller steps, or starts from rest.
        force = now.known.load[FORCE]
        now.loaded = statics.solve(joints, pure_force(force), last.loaded)
        now.unloaded = statics.solve(joints, _NO_LOAD, last.unloaded)
        estimate(
            estimator.settings, now.loaded.numbers, now.unloaded.numbers, *before,
            force, sent, frame, age, numbers,
        )  # fmt: skip
    return Perception(load, now)


@compiled
def _perceive(
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], settings: Array,
    load_settings: Array, joints: Array, wrenches: Array, sent: Array, frame: Array, age: float,
    near_loaded: Array, near_unloaded: Array, last: Array, careful: int,
    load: Array, loaded: Array, unloaded: Array, now: Array,
) -> bool:  # fmt: skip
    """Compute `perceive` into the last four arguments; return False if the model was not solved.

    After False only the load is valid: the sum `load` and the force estimate in `now`. The argument `careful` is always
    1. As a constant inside this function, `careful` would make the compiler build a second Newton solver.
    """
    layout = unpack(packed)
    copy(fused_at(layout, joints, wrenches), load)
    copy(last, now)
    force = estimate_fields(now).load
    estimate_force(
        load_settings, settings[0], layout, joints, wrenches, fields(near_loaded).tip, estimate_fields(last).load, force
    )
    wrench, nothing, tip, close = np.zeros(6), np.zeros(6), math.inf, CONTROL_STEP_RAD
    copy(force[FORCE], wrench)
    if not (
        newton(packed, order, sublink, joints, wrench, near_loaded, tip, careful, close, tubes, columns, loaded)
        and newton(
            packed, order, sublink, joints, nothing, near_unloaded, tip, careful, close, tubes, columns, unloaded
        )
    ):
        return False
    estimate(settings, loaded, unloaded, near_loaded, near_unloaded, last, force[FORCE], sent, frame, age, now)
    return True
