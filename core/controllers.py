"""The paper's control strategies (section III): an outer loop that asks for a tip velocity and an
inner loop that turns it into what the joints must solve.

| strategy | outer | inner |
|---|---|---|
| `unloaded_jacobian` (a) | velocity of the trajectory | J(q, 0) |
| `loaded_jacobian` (b) | velocity of the trajectory | J(q, w) |
| `inner_loop` (c) | velocity of the trajectory | Type I, eq. (24) |
| `dual_layer` (d) | eq. (30) on the tracker | Type I, eq. (24) |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from core.errors import DescriptionError
from core.robot import Array
from core.statics import Solution
from core.trajectories import Setpoint


class View(NamedTuple):
    """What an inner loop may look at."""

    loaded: Solution  #: F(q, w) and its derivatives
    unloaded: Solution  #: F(q, 0) and its derivatives
    deflection_rate: Array  #: (3,) estimated rate of Delta_total [m/s]


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
        u_int = self.k2 * setpoint.position - self.k1 * tip
        return u_int + setpoint.velocity if self.feedforward else u_int


def unloaded(u_int: Array, view: View) -> Wanted:
    """J(q, 0) q' = U_int: the load is ignored."""
    return Wanted(view.unloaded.jacobian[:3], u_int)


def loaded(u_int: Array, view: View) -> Wanted:
    """J(q, w) q' = U_int: the load changes the Jacobian, its own motion of the tip is ignored."""
    return Wanted(view.loaded.jacobian[:3], u_int)


def type_1(u_int: Array, view: View) -> Wanted:
    """Eq. (24), J(q, 0) q' = U_int - d(Delta_total)/dt."""
    return Wanted(view.unloaded.jacobian[:3], u_int - view.deflection_rate)


@dataclass(frozen=True)
class Strategy:
    """An outer loop on an inner loop."""

    outer: OuterLoop
    inner: InnerLoop


def _velocity_mode(inner: InnerLoop) -> Callable[[PositionMode], Strategy]:
    return lambda _gains: Strategy(VelocityMode(), inner)


#: Strategies by name; each takes the gains of the outer loop and uses them if it has one.
STRATEGIES: dict[str, Callable[[PositionMode], Strategy]] = {
    "unloaded_jacobian": _velocity_mode(unloaded),
    "loaded_jacobian": _velocity_mode(loaded),
    "inner_loop": _velocity_mode(type_1),
    "dual_layer": lambda gains: Strategy(gains, type_1),
}


def strategy(name: str, k1: float = 2.5, k2: float = 2.5, feedforward: bool = False) -> Strategy:
    """The strategy of that name.

    Raises:
        DescriptionError: unknown name, or gains outside 0 ... 50 1/s.

    """
    if name not in STRATEGIES:
        raise DescriptionError(f"strategy '{name}' is unknown; choose one of {', '.join(STRATEGIES)}")
    return STRATEGIES[name](PositionMode(k1, k2, feedforward))
