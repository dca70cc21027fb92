"""estimate -> joint velocities, in one compiled call: outer loop, inner loop, inverse inside the limits.

Loops of one's own, in Python, take the place of the first two; the inverse and the limits are the same for all.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.controllers import Strategy, VelocityTask, View, inner_law, outer_law
from core.control.estimation import Estimate, known_of
from core.control.inverse import HUNTING, NO_ROOM, inverse_at, inverse_law, no_rows, no_spare
from core.control.pointing import NOT_ASKED, PLACE, Aim, with_direction
from core.control.trajectories import Setpoint
from core.errors import NotFinite
from core.model.solution import parts
from core.robot.limits import Limits, velocity_bounds
from core.robot.robot import Array


class Commanded(NamedTuple):
    """Joint velocities, what was asked for, and how they were limited."""

    velocity: Array  #: (n,) [rad/s or m/s]
    u_int: Array  #: (3,) what the outer loop asked for [m/s]
    sigma: Array  #: (min(3, n),) the smallest singular values of the rows in use, joints in units of top speed [m/s]
    at_bound: Array  #: (n,) -1, 0, 1: joint held at its lower bound, free, at its upper
    at_row: Array  #: (m,) 1 where a limit beyond single joints is active


#: The tip's drift is the observer's.
OBSERVED = np.zeros(0)


class Looks(NamedTuple):
    """What the loops look at."""

    lead: float  #: the outer loop aims at the setpoint of so much later [s]
    observes: bool  #: it looks at the observed tip, that much later; else at the latest tracker frame
    exact_rate: bool  #: Type I takes the deflection's rate from C, J and the filtered force


def command(
    strategy: Strategy, looks: Looks, limits: Limits,
    joints: Array, now: Estimate, force: Array, setpoint: Setpoint, tip: Array, origin: Array, drift: Array = OBSERVED,
    aim: Aim = PLACE, pointing: Array = NOT_ASKED, spare: Array | None = None,
) -> Commanded:  # fmt: skip
    """Joint velocities for a setpoint.

    Args:
        strategy: outer and inner loop.
        looks: what they look at.
        limits: of the joints, and beyond single joints.
        joints: (n,) [rad or m].
        now: the estimate of this tick.
        force: (3,) on the tip as measured [N].
        setpoint: from `origin`.
        tip: (3,) the latest tracker frame [m].
        origin: (3,) [m].
        drift: (3,) tip velocity beyond J q' + C w' [m/s], or `OBSERVED`.
        aim: what of the tip is controlled; loops of one's own control the place.
        pointing: (6, 3) what `pointing.told` says of the direction, where that is asked for.
        spare: (n,) what joints that are left over should do [rad/s or m/s]; nothing when left out.

    Raises:
        NotFinite: what is asked for, or the Jacobian, is not.

    """
    rows, room = no_rows(joints.size), NO_ROOM
    if limits.others:
        rows, room = limits.rows(_Now(joints, now, force))
    if strategy.laws is None:
        u_int, task = _own_loops(strategy, looks, now, setpoint, tip, origin, drift)
        jacobian, velocity = (np.ascontiguousarray(side, dtype=np.float64) for side in task)
        found = inverse_at(limits, joints, jacobian, velocity, rows, room)
        return Commanded(found.velocity, u_int, found.sigma, found.at_bound, found.at_row)
    n = joints.size
    found = Commanded(np.empty(n), np.empty(3), np.empty(min(3, n)), np.empty(n), np.empty(room.size))
    if not _command(
        *strategy.laws, *looks, limits.packed, joints, now.loaded.numbers, now.unloaded.numbers, now.numbers,
        setpoint.position, setpoint.velocity, tip, origin, drift, aim.place, aim.lever, pointing, rows, room,
        no_spare(n) if spare is None else spare, aim.floor, HUNTING, *found,
    ):  # fmt: skip
        raise NotFinite(f"wanted tip velocity {found.u_int.tolist()} m/s or the Jacobian is not finite")
    return found


class _Now:
    """The situation of a tick: the tube order, which most robots have alone, needs the joints alone."""

    __slots__ = ("_now", "force", "joints")

    def __init__(self, joints: Array, now: Estimate, force: Array) -> None:
        self.joints, self._now, self.force = joints, now, force

    @property
    def jacobian(self) -> Array:
        """(3, n)."""
        return self._now.loaded.jacobian[:3]

    @property
    def tip(self) -> Array:
        """(3,)."""
        return self._now.observed.tip


def _own_loops(
    strategy: Strategy, looks: Looks, now: Estimate, setpoint: Setpoint, tip: Array, origin: Array, drift: Array
) -> tuple[Array, VelocityTask]:
    """U_int (3,) and the equation for the joints."""
    known = now.known
    aim = Setpoint(_aim(looks.lead, setpoint.position, setpoint.velocity), setpoint.velocity)
    u_int = strategy.outer.tip_velocity(aim, (known.tip_ahead if looks.observes else tip) - origin)
    rate = known.deflection_rate_exact if looks.exact_rate else known.deflection_rate
    drift = known.drift if drift.size == 0 else drift
    return u_int, strategy.inner(u_int, View(now.loaded, now.unloaded, rate, known.load_rate, drift))


@compiled
def _aim(lead: float, wanted: Array, velocity: Array) -> Array:
    """Where the setpoint will be when a command of now takes effect (3,) [m]."""
    aim = np.empty(3)
    for i in range(3):
        aim[i] = wanted[i] + lead * velocity[i]
    return aim


@compiled
def _command(
    k1: float, k2: float, feedforward: float, number: int, lead: float, observes: bool, exact_rate: bool,
    limits: Array, joints: Array, loaded: Array, unloaded: Array, estimate: Array,
    wanted: Array, velocity: Array, tip: Array, origin: Array, drift: Array,
    place: float, lever: float, pointing: Array, rows: Array, room: Array, spare: Array,
    least_floor: float, hunting: float,
    command: Array, u_int: Array, sigma: Array, at_bound: Array, at_row: Array,
) -> bool:  # fmt: skip
    """`command` of the project's own loops, into the last five; False when what was wanted is not finite."""
    now, here = known_of(estimate), np.empty(3)
    for i in range(3):
        here[i] = (now.tip_ahead[i] if observes else tip[i]) - origin[i]
    copy(outer_law(k1, k2, feedforward, _aim(lead, wanted, velocity), velocity, here), u_int)
    rate = now.deflection_rate_exact if exact_rate else now.deflection_rate
    with_load, free = parts(loaded), parts(unloaded)
    jacobian, asked = inner_law(
        number, u_int, with_load.jacobian, free.jacobian, rate, now.load_rate, now.drift if drift.size == 0 else drift
    )
    jacobian, asked = with_direction(
        place, lever, number, k1, feedforward, lead,
        jacobian, asked, with_load.jacobian, free.jacobian, with_load.rotation, pointing,
    )  # fmt: skip
    lower, upper = velocity_bounds(joints, limits)
    found, values, held, active, finite = inverse_law(
        jacobian, asked, limits[2], lower, upper, rows, room, spare, least_floor, hunting
    )
    copy(found, command)
    for i in range(sigma.shape[0]):
        sigma[i] = values[max(0, values.shape[0] - sigma.shape[0] + i)]
    copy(held, at_bound)
    copy(active, at_row)
    return finite
