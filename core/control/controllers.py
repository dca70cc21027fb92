"""The paper's control strategies (section III): each strategy combines an outer loop and an inner loop.

The outer loop requests a tip velocity U. The inner loop turns U into an equation for the joint velocities q'. Here J is
the Jacobian by the joints q, C the compliance, w the load on the tip, and X the tip position.

| strategy | outer | inner |
|---|---|---|
| `unloaded_jacobian` (a) | velocity of the trajectory | J(q, 0) |
| `loaded_jacobian` (b) | velocity of the trajectory | J(q, w) |
| `inner_loop` (c) | velocity of the trajectory | one of the inner loops below |
| `dual_layer` (d) | eq. (30) on the measured tip | one of the inner loops below |

| inner loop | equation |
|---|---|
| `type_1` | J(q, 0) q' = U - d(Delta_total)/dt, eq. (24); the filtered rate contains q' of earlier ticks |
| `type_1_exact` | J(q, w) q' = U - C w': the same equation solved for q' |
| `unloaded`, `loaded` | J(q, 0) q' = U, J(q, w) q' = U: without compensation of the tip motion that the load causes |
| `type_2` | J(q, w) q' = U - (X' - J(q, w) q'), eq. (29); X' is the tip's velocity from observer or tracker frames |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from core.compiled import compiled
from core.contract import name_of, numbers, pair, reset_state, result_of
from core.control.trajectories import Setpoint
from core.control.velocity_ik import VelocityTask
from core.errors import ContractError, DescriptionError
from core.model.statics import Solution
from core.robot.robot import Array


class LoopInputs(NamedTuple):
    """The model's solutions and the estimates that an inner loop may use."""

    loaded: Solution  #: solution of the model under the measured load: tip F(q, w) and its derivatives
    unloaded: Solution  #: solution of the model without load: tip F(q, 0) and its derivatives
    deflection_rate: Array  #: (3,) rate of the deflection under load, from a filter or from C and J [m/s]
    load_rate: Array  #: (3,) C(q, w) w', the tip velocity that the load alone causes [m/s]
    drift: Array  #: (3,) tip velocity X' - J q' - C w' that neither joints nor load explain [m/s]


class FeedbackOptions(NamedTuple):
    """Measurements and estimates that the loops use as feedback."""

    lead_time: float  #: time by which the outer loop predicts the setpoint [s]
    observes: bool  #: True: feedback is the observed tip, predicted by `lead_time`; False: the latest tracker frame
    exact_rate: bool  #: True: the inner loop Type I computes the deflection's rate from C, J and the filtered force


class TaskInputs(NamedTuple):
    """Inputs of a task: the built-in loops, their feedback, and the model's solutions."""

    laws: tuple[float, float, float, int]  #: gains of the outer loop and number of the inner loop, `Strategy.laws`
    feedback: FeedbackOptions
    loaded: Solution  #: solution of the model under the measured load
    unloaded: Solution  #: solution of the model without load


class Task(Protocol):
    """A control task in addition to the tip's position, for example the tip's direction."""

    def rows(self, at: TaskInputs) -> VelocityTask:
        """Return the task's rows, one equation for the joint velocities each, in units of the position [m/s]."""
        ...


def custom_rows(task: Task, at: TaskInputs) -> VelocityTask:
    """Return the rows of a custom task after checking them; the task receives copies of all arrays.

    Raises:
        ContractError: the task raised, or its rows have a wrong shape or are not finite.

    """
    who, n = f"task '{name_of(task)}'", at.loaded.joints.size
    own = at._replace(loaded=at.loaded.copy(), unloaded=at.unloaded.copy())
    rows, sides = pair(who, result_of(who, task.rows, own), "VelocityTask(jacobian, velocity)")
    m = len(result_of(who, np.atleast_1d, sides))
    return VelocityTask(
        numbers(who, "jacobian", rows, (m, n), "m/rad or m/m"), numbers(who, "velocity", sides, (m,), "m/s")
    )


class OuterLoop(Protocol):
    """Outer loop: requests a tip velocity U_int from the inner loop.

    A loop with a state, for example an integral, also has a method `reset()`, which is called before each motion.
    """

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Return the requested tip velocity U_int (3,) [m/s].

        The setpoint and the measured tip (3,) are relative to the tip at the start of the motion [m].
        """
        ...


class InnerLoop(Protocol):
    """Inner loop: turns U_int (3,) [m/s] into a velocity equation for the joints."""

    def __call__(self, u_int: Array, view: LoopInputs, /) -> VelocityTask:
        """Return the equation that the joint velocities must satisfy."""
        ...


@dataclass(frozen=True)
class VelocityMode:
    """Outer loop without feedback: it requests the trajectory's velocity."""

    law = (0.0, 0.0, 1.0)  #: gains K1 and K2, and weight of the desired velocity, for `outer_law`

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:  # noqa: ARG002 - open loop
        """Return the desired velocity, independent of the measured tip."""
        return setpoint.velocity


@dataclass(frozen=True)
class PositionMode:
    """Outer loop with position feedback, eq. (30): U_int = -K1 X + K2 X_des, optionally with feed-forward of velocity.

    Without feed-forward and with K1 = K2 = k, the tip lags behind a sinusoidal motion. At the angular frequency w
    [rad/s] the error is the amplitude times |w / (k + jw)|, eq. (31).
    """

    k1: float  #: gain of the measured tip position [1/s]
    k2: float  #: gain of the desired tip position [1/s]
    feedforward: bool = False  #: whether the desired velocity is added to U_int

    def __post_init__(self) -> None:
        for name, gain in (("K1", self.k1), ("K2", self.k2)):
            if not (math.isfinite(gain) and 0.0 <= gain <= 50.0):
                raise DescriptionError(f"{name} = {gain:g} 1/s is outside 0 ... 50 1/s")

    @property
    def law(self) -> tuple[float, float, float]:
        """Gains K1 and K2, and weight of the desired velocity, for `outer_law`."""
        return self.k1, self.k2, float(self.feedforward)

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Return U_int of eq. (30)."""
        return outer_law(*self.law, setpoint.position, setpoint.velocity, tip)


@compiled
def outer_law(k1: float, k2: float, feedforward: float, desired: Array, velocity: Array, tip: Array) -> Array:
    """Return the requested tip velocity U_int (3,) of eq. (30), with the desired velocity weighted by `feedforward`."""
    u_int = np.empty(3)
    for i in range(3):
        u_int[i] = k2 * desired[i] - k1 * tip[i] + feedforward * velocity[i]
    return u_int


class InnerLaw(NamedTuple):
    """Built-in inner loop: an `InnerLoop` that compiled code selects by the field `number`."""

    number: int

    def __call__(self, u_int: Array, view: LoopInputs, /) -> VelocityTask:
        """Return the equation that the joint velocities must satisfy."""
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
    """Return both sides of the equation of the inner loop `number`; `loaded` and `unloaded` are Jacobians (6, n)."""
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


#: Inner loop J(q, 0) q' = U_int, which ignores the load.
unloaded = InnerLaw(UNLOADED)
#: Inner loop J(q, w) q' = U_int, which uses the loaded Jacobian but ignores the tip motion that the load causes.
loaded = InnerLaw(LOADED)
#: Inner loop of eq. (24), J(q, 0) q' = U_int - d(Delta_total)/dt.
type_1 = InnerLaw(TYPE_1)
#: Inner loop J(q, w) q' = U_int - C w': eq. (21) solved for q', equal to eq. (24) with an exact Delta_total.
type_1_exact = InnerLaw(TYPE_1_EXACT)
#: Inner loop of eq. (29), J(q, w) q' = U_int - (X' - J(q, w) q'). This loop compensates every motion of the tip that
#: the joints do not cause.
type_2 = InnerLaw(TYPE_2)

#: Inner loops of strategies (c) and (d) by name.
INNER_LOOPS: dict[str, InnerLoop] = {
    "type_1": type_1, "type_1_exact": type_1_exact, "type_2": type_2, "loaded": loaded, "unloaded": unloaded,
}  # fmt: skip


@dataclass(frozen=True)
class Strategy:
    """A control strategy: an outer loop and the inner loop that it commands."""

    outer: OuterLoop
    inner: InnerLoop

    @cached_property
    def laws(self) -> tuple[float, float, float, int] | None:
        """Gains of the outer loop and number of the inner loop, for compiled code; None for custom loops."""
        outer: Any = self.outer
        inner: Any = self.inner
        if (type(outer) is VelocityMode or type(outer) is PositionMode) and type(inner) is InnerLaw:
            return (*outer.law, inner.number)
        return None

    @property
    def gain(self) -> float:
        """Gain K1 of the measured tip in the outer loop; 0 without feedback and for custom loops [1/s]."""
        return 0.0 if self.laws is None else self.laws[0]

    @property
    def names(self) -> tuple[str, str]:
        """Names of outer and inner loop, for messages."""
        inner = self.inner
        known = next((name for name, loop in INNER_LOOPS.items() if loop is inner), name_of(inner))
        return f"outer loop '{name_of(self.outer)}'", f"inner loop '{known}'"

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Return the tip velocity U_int (3,) [m/s] that the outer loop requests.

        Raises:
            ContractError: the outer loop raised, or returned something other than three finite numbers.

        """
        who = self.names[0]
        return numbers(who, "U_int", result_of(who, self.outer.tip_velocity, setpoint, tip), (3,), "m/s")

    def velocity_task(self, u_int: Array, view: LoopInputs) -> VelocityTask:
        """Return the inner loop's equation for the joint velocities.

        Raises:
            ContractError: the inner loop raised, or returned something other than finite numbers (3, n) and (3,).

        """
        who = self.names[1]
        returned = result_of(who, self.inner, u_int, view)
        jacobian, velocity = pair(who, returned, "VelocityTask(jacobian, velocity)")
        return VelocityTask(
            numbers(who, "the Jacobian", jacobian, (3, view.loaded.joints.size), "m/rad or m/m"),
            numbers(who, "the velocity", velocity, (3,), "m/s"),
        )

    def reset(self) -> None:
        """Call `reset` of the loops that have one, because a motion starts.

        Raises:
            ContractError: a loop raised.

        """
        for who, loop in zip(self.names, (self.outer, self.inner), strict=True):
            reset_state(who, loop)

    def check(self, at: Solution) -> None:
        """Call custom loops once before the robot moves, as if it were at rest on its setpoint in the pose `at`.

        Raises:
            ContractError: a custom loop raised, or returned a value that violates its interface.

        """
        if self.laws is None:
            rest = np.zeros((6, 3))
            u_int = self.tip_velocity(Setpoint(rest[0], rest[1]), rest[2])
            self.velocity_task(u_int, LoopInputs(at.copy(), at.copy(), *rest[3:]))


#: Functions by strategy name; each returns a strategy from the outer loop's gains and an inner loop, and may ignore
#: both arguments.
STRATEGIES: dict[str, Callable[[PositionMode, InnerLoop], Strategy]] = {
    "unloaded_jacobian": lambda _gains, _inner: Strategy(VelocityMode(), unloaded),
    "loaded_jacobian": lambda _gains, _inner: Strategy(VelocityMode(), loaded),
    "inner_loop": lambda _gains, inner: Strategy(VelocityMode(), inner),
    "dual_layer": Strategy,
}


def strategy(
    name: str, k1: float = 2.5, k2: float = 2.5, feedforward: bool = False, inner: str | InnerLoop = "type_1"
) -> Strategy:
    """Return the control strategy with this name; `inner` is an inner loop or the name of one.

    Raises:
        DescriptionError: unknown strategy or inner loop, or gains outside 0 ... 50 1/s.
        ContractError: a custom strategy raised, or returned something other than a `Strategy`.

    """
    for what, given, known in (("strategy", name, STRATEGIES), ("inner loop", inner, INNER_LOOPS)):
        if isinstance(given, str) and given not in known:
            raise DescriptionError(f"{what} '{given}' is unknown; choose one of {', '.join(known)}")
    loop = INNER_LOOPS[inner] if isinstance(inner, str) else inner
    made = result_of(f"strategy '{name}'", STRATEGIES[name], PositionMode(k1, k2, feedforward), loop)
    if not isinstance(made, Strategy):
        raise ContractError(f"strategy '{name}' returned a {type(made).__name__}; it must return a Strategy")
    return made
