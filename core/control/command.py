"""From an estimate to joint velocities in one compiled call: outer loop, inner loop, inverse inside the limits.

For the project's own strategies without limits beyond single joints; `core.control.step` does the same piece by piece
for all others.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.controllers import inner_law, outer_law
from core.control.estimation import DEFLECTION_RATE, EXACT_RATE, LOAD_RATE, TIP_AHEAD, Estimate
from core.control.inverse import HUNTING, SIGMA_FLOOR, inverse_law
from core.control.trajectories import Setpoint
from core.errors import NotFinite
from core.robot.limits import Limits, velocity_bounds
from core.robot.robot import Array


class Commanded(NamedTuple):
    """Joint velocities, what was asked for, and how they were limited; see `Inverse` and `Tick`."""

    velocity: Array
    u_int: Array
    sigma: Array
    at_bound: Array


def follow(
    laws: tuple[float, float, float, int], lead: float, exact_rate: bool, limits: Limits,
    joints: Array, now: Estimate, setpoint: Setpoint, tip: Array | None, origin: Array,
) -> Commanded:  # fmt: skip
    """Joint velocities for a setpoint.

    Args:
        laws: `Strategy.laws`.
        lead: the outer loop aims at the setpoint of so much later [s].
        exact_rate: Type I takes the deflection's rate from C, J and the filtered force.
        limits: of the joints.
        joints: (n,) [rad or m].
        now: the estimate of this tick.
        setpoint: from `origin`.
        tip: (3,) the tip that the outer loop looks at [m]; None for the observed one, that much later.
        origin: (3,) [m].

    Raises:
        NotFinite: something in it is not.

    """
    k1, k2, feedforward, number = laws
    n = joints.size
    velocity, u_int, sigma, at_bound = np.empty(n), np.empty(3), np.empty(min(3, n)), np.empty(n)
    if not _follow(
        k1, k2, feedforward, number, lead, exact_rate, tip is None, limits.packed, joints,
        now.loaded.numbers, now.unloaded.numbers, now.numbers,
        setpoint.position, setpoint.velocity, origin if tip is None else tip, origin, SIGMA_FLOOR, HUNTING,
        velocity, u_int, sigma, at_bound,
    ):  # fmt: skip
        raise NotFinite(f"wanted tip velocity {u_int.tolist()} m/s or the Jacobian is not finite")
    return Commanded(velocity, u_int, sigma, at_bound)


@compiled
def _follow(
    k1: float, k2: float, feedforward: float, number: int, lead: float, exact_rate: bool, observes: bool,
    limits: Array, joints: Array, loaded: Array, unloaded: Array, estimate: Array,
    wanted: Array, velocity: Array, tip: Array, origin: Array, least_floor: float, hunting: float,
    command: Array, u_int: Array, sigma: Array, at_bound: Array,
) -> bool:  # fmt: skip
    """`follow`, into the last four; False when what was wanted is not finite."""
    n, vectors = joints.shape[0], estimate[:39].reshape(13, 3)
    aim, here = np.empty(3), np.empty(3)
    for i in range(3):
        aim[i] = wanted[i] + lead * velocity[i]
        here[i] = (vectors[TIP_AHEAD, i] if observes else tip[i]) - origin[i]
    copy(outer_law(k1, k2, feedforward, aim, velocity, here), u_int)
    jacobian, asked = np.empty((3, n)), np.empty(3)
    inner_law(
        number, u_int, loaded[12 : 12 + 6 * n].reshape(6, n), unloaded[12 : 12 + 6 * n].reshape(6, n),
        vectors[EXACT_RATE if exact_rate else DEFLECTION_RATE], vectors[LOAD_RATE], estimate[42:45], jacobian, asked,
    )  # fmt: skip
    lower, upper = velocity_bounds(joints, limits)
    found, values, held, _, finite = inverse_law(
        jacobian, asked, limits[2], lower, upper, np.empty((0, n)), np.empty(0), least_floor, hunting
    )
    copy(found, command)
    copy(values, sigma)
    copy(held, at_bound)
    return finite
