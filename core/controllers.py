"""The paper's control strategies (section III): an outer loop that asks for a tip velocity and an
inner loop that turns it into what the joints must solve.

| strategy | outer | inner |
|---|---|---|
| `unloaded_jacobian` (a) | velocity of the trajectory | J(q, 0) |
| `loaded_jacobian` (b) | velocity of the trajectory | J(q, w) |
| `inner_loop` (c) | velocity of the trajectory | one of the three below |
| `dual_layer` (d) | eq. (30) on the measured tip | one of the three below |

| inner loop | equation |
|---|---|
| `type_1` | J(q, 0) q' = U - d(Delta_total)/dt, eq. (24); Delta_2 holds q' itself: a delayed fixed point |
| `type_1_exact` | J(q, w) q' = U - C w', the same without the fixed point |
| `type_2` | J(q, w) q' = U - (X' - J(q, w) q'), eq. (29), X' being the tip's velocity as observed |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError
from core.robot import Array
from core.statics import Solution
from core.trajectories import Setpoint


class View(NamedTuple):
    """What an inner loop may look at."""

    loaded: Solution  #: F(q, w) and its derivatives
    unloaded: Solution  #: F(q, 0) and its derivatives
    deflection_rate: Array  #: (3,) rate of Delta_total, by filter or by C and J [m/s]
    load_rate: Array  #: (3,) C(q, w) w', the tip's velocity by the load alone [m/s]
    drift: Array  #: (3,) tip velocity beyond J q' + C w', as the tracker shows it: X' - J q' - C w' [m/s]


class Wanted(NamedTuple):
    """The joints should satisfy jacobian @ joint_velocity = velocity."""

    jacobian: Array  #: (3, n) [m/rad or m/m]
    velocity: Array  #: (3,) [m/s]


class OuterLoop(Protocol):
    """Asks the inner loop for a tip velocity U_int."""

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """U_int (3,) [m/s] from the setpoint and the measured tip (3,), both from the start tip [m]."""
        ...


class InnerLoop(Protocol):
    """Turns U_int (3,) [m/s] into a velocity equation for the joints."""

    def __call__(self, u_int: Array, view: View, /) -> Wanted:
        """The equation the joints must solve."""
        ...


@dataclass(frozen=True)
class VelocityMode:
    """No feedback: U_int is the trajectory's velocity."""

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:  # noqa: ARG002 - open loop
        """Desired velocity, whatever the tracker says."""
        return setpoint.velocity


@dataclass(frozen=True)
class PositionMode:
    """Eq. (30), U_int = -K1 X + K2 X_des, optionally with the desired velocity fed forward.

    Without feed-forward the tip lags as eq. (31) says, by |w / (k + jw)| of a motion at w.
    """

    k1: float  #: [1/s]
    k2: float  #: [1/s]
    feedforward: bool = False

    def __post_init__(self) -> None:
        for name, gain in (("K1", self.k1), ("K2", self.k2)):
            if not (math.isfinite(gain) and 0.0 <= gain <= 50.0):
                raise DescriptionError(f"{name} = {gain:g} 1/s is outside 0 ... 50 1/s")

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Eq. (30)."""
        feedforward = 1.0 if self.feedforward else 0.0
        return _position_law(self.k1, self.k2, feedforward, setpoint.position, setpoint.velocity, tip)


@compiled
def _position_law(k1: float, k2: float, feedforward: float, wanted: Array, velocity: Array, tip: Array) -> Array:
    """Eq. (30); compiled, because numpy takes longer for the call than for the sum."""
    u_int = np.empty(3)
    for i in range(3):
        u_int[i] = k2 * wanted[i] - k1 * tip[i] + feedforward * velocity[i]
    return u_int


def unloaded(u_int: Array, view: View) -> Wanted:
    """J(q, 0) q' = U_int: the load is ignored."""
    return Wanted(view.unloaded.jacobian[:3], u_int)


def loaded(u_int: Array, view: View) -> Wanted:
    """J(q, w) q' = U_int: the load changes the Jacobian, its own motion of the tip is ignored."""
    return Wanted(view.loaded.jacobian[:3], u_int)


def type_1(u_int: Array, view: View) -> Wanted:
    """Eq. (24), J(q, 0) q' = U_int - d(Delta_total)/dt."""
    return Wanted(view.unloaded.jacobian[:3], u_int - view.deflection_rate)


def type_1_exact(u_int: Array, view: View) -> Wanted:
    """J(q, w) q' = U_int - C w': eq. (21) solved for q', equal to (24) with an exact Delta_total."""
    return Wanted(view.loaded.jacobian[:3], u_int - view.load_rate)


def type_2(u_int: Array, view: View) -> Wanted:
    """Eq. (29), J(q, w) q' = U_int - (X' - J(q, w) q'): whatever moves the tip besides the joints."""
    return Wanted(view.loaded.jacobian[:3], u_int - (view.load_rate + view.drift))


#: Inner loops of strategies (c) and (d) by name.
INNER_LOOPS: dict[str, InnerLoop] = {"type_1": type_1, "type_1_exact": type_1_exact, "type_2": type_2}


@dataclass(frozen=True)
class Strategy:
    """An outer loop on an inner loop."""

    outer: OuterLoop
    inner: InnerLoop


#: Strategies by name; each takes the gains of the outer loop and the inner loop and uses what it has.
STRATEGIES: dict[str, Callable[[PositionMode, InnerLoop], Strategy]] = {
    "unloaded_jacobian": lambda _gains, _inner: Strategy(VelocityMode(), unloaded),
    "loaded_jacobian": lambda _gains, _inner: Strategy(VelocityMode(), loaded),
    "inner_loop": lambda _gains, inner: Strategy(VelocityMode(), inner),
    "dual_layer": Strategy,
}


def strategy(name: str, k1: float = 2.5, k2: float = 2.5, feedforward: bool = False, inner: str = "type_1") -> Strategy:
    """The strategy of that name.

    Raises:
        DescriptionError: unknown strategy or inner loop, or gains outside 0 ... 50 1/s.

    """
    for what, given, known in (("strategy", name, STRATEGIES), ("inner loop", inner, INNER_LOOPS)):
        if given not in known:
            raise DescriptionError(f"{what} '{given}' is unknown; choose one of {', '.join(known)}")
    return STRATEGIES[name](PositionMode(k1, k2, feedforward), INNER_LOOPS[inner])
