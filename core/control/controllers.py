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
| `type_2` | J(q, w) q' = U - (X' - J(q, w) q'), eq. (29), X' being the tip's velocity as observed or by frames |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from core.compiled import compiled
from core.control.trajectories import Setpoint
from core.errors import DescriptionError
from core.model.statics import Solution
from core.robot.robot import Array


class View(NamedTuple):
    """What an inner loop may look at."""

    loaded: Solution  #: F(q, w) and its derivatives
    unloaded: Solution  #: F(q, 0) and its derivatives
    deflection_rate: Array  #: (3,) rate of Delta_total, by filter or by C and J [m/s]
    load_rate: Array  #: (3,) C(q, w) w', the tip's velocity by the load alone [m/s]
    drift: Array  #: (3,) tip velocity beyond J q' + C w', as observed or as frames show it: X' - J q' - C w' [m/s]


class VelocityTask(NamedTuple):
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

    def __call__(self, u_int: Array, view: View, /) -> VelocityTask:
        """The equation the joints must solve."""
        ...


@dataclass(frozen=True)
class VelocityMode:
    """No feedback: U_int is the trajectory's velocity."""

    law = (0.0, 0.0, 1.0)  #: K1, K2 and the weight of the desired velocity, for `outer_law`

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

    @property
    def law(self) -> tuple[float, float, float]:
        """K1, K2 and the weight of the desired velocity, for `outer_law`."""
        return self.k1, self.k2, float(self.feedforward)

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Eq. (30)."""
        return outer_law(*self.law, setpoint.position, setpoint.velocity, tip)


@compiled
def outer_law(k1: float, k2: float, feedforward: float, wanted: Array, velocity: Array, tip: Array) -> Array:
    """Eq. (30) with the desired velocity weighted: U_int (3,) [m/s]."""
    u_int = np.empty(3)
    for i in range(3):
        u_int[i] = k2 * wanted[i] - k1 * tip[i] + feedforward * velocity[i]
    return u_int


class InnerLaw(NamedTuple):
    """One of the project's inner loops: an `InnerLoop` that compiled code knows by its number."""

    number: int

    def __call__(self, u_int: Array, view: View, /) -> VelocityTask:
        """The equation the joints must solve."""
        return VelocityTask(
            *inner_law(
                self.number, u_int, view.loaded.jacobian, view.unloaded.jacobian,
                view.deflection_rate, view.load_rate, view.drift,
            )
        )  # fmt: skip


UNLOADED, LOADED, TYPE_1, TYPE_1_EXACT, TYPE_2 = range(5)


@compiled
def inner_law(
    number: int, u_int: Array, loaded: Array, unloaded: Array, deflection_rate: Array, load_rate: Array, drift: Array
) -> tuple[Array, Array]:
    """Left and right side of the inner loops' equations; `loaded` and `unloaded` are Jacobians (6, n)."""
    n = loaded.shape[1]
    jacobian, velocity = np.empty((3, n)), np.empty(3)
    for i in range(3):
        for j in range(n):
            jacobian[i, j] = unloaded[i, j] if number in (UNLOADED, TYPE_1) else loaded[i, j]
        if number == TYPE_1:  # (23), (24)
            by_load = deflection_rate[i]
        elif number == TYPE_1_EXACT:  # (21)
            by_load = load_rate[i]
        elif number == TYPE_2:  # (29): X' - J(q, w) q'
            by_load = load_rate[i] + drift[i]
        else:
            by_load = 0.0
        velocity[i] = u_int[i] - by_load
    return jacobian, velocity


#: J(q, 0) q' = U_int: the load is ignored.
unloaded = InnerLaw(UNLOADED)
#: J(q, w) q' = U_int: the load changes the Jacobian, its own motion of the tip is ignored.
loaded = InnerLaw(LOADED)
#: Eq. (24), J(q, 0) q' = U_int - d(Delta_total)/dt.
type_1 = InnerLaw(TYPE_1)
#: J(q, w) q' = U_int - C w': eq. (21) solved for q', equal to (24) with an exact Delta_total.
type_1_exact = InnerLaw(TYPE_1_EXACT)
#: Eq. (29), J(q, w) q' = U_int - (X' - J(q, w) q'): whatever moves the tip besides the joints.
type_2 = InnerLaw(TYPE_2)

#: Inner loops of strategies (c) and (d) by name.
INNER_LOOPS: dict[str, InnerLoop] = {"type_1": type_1, "type_1_exact": type_1_exact, "type_2": type_2}


@dataclass(frozen=True)
class Strategy:
    """An outer loop on an inner loop."""

    outer: OuterLoop
    inner: InnerLoop

    @cached_property
    def laws(self) -> tuple[float, float, float, int] | None:
        """What `core.control.command` is told of the project's own loops; None for loops of one's own."""
        if isinstance(self.outer, VelocityMode | PositionMode) and isinstance(self.inner, InnerLaw):
            return (*self.outer.law, self.inner.number)
        return None


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
