"""One tick of the controller, 2 ms at 500 Hz, as a pure function: sample -> estimate -> command.

    fuse the base wrenches -> solve the loaded and the unloaded model -> filter the deflection's
    rate -> outer loop -> inner loop -> inverse inside the limits -> check finite

No clock, no device, no thread: everything that changes goes in as `Memory` and comes out anew.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.controllers import Strategy, View
from core.deflection import Rate, RateFilter
from core.errors import NotFinite
from core.inverse import inverse
from core.limits import Limits
from core.robot import Array
from core.statics import Solution, Statics
from core.trajectories import JointMotion, Setpoint
from core.wrench import Fused, fuse


class Sample(NamedTuple):
    """What the devices say at one tick."""

    joints: Array  #: (n,) measured [rad or m]
    wrenches: Array  #: (q, 6) tared base wrenches, each in its sensor's axes [N, N m]
    tip: Array | None  #: (3,) a new tracker frame [m]; None when none arrived since the last tick


class Memory(NamedTuple):
    """All that one tick leaves to the next."""

    loaded: Solution
    unloaded: Solution
    deflection: Rate  #: Delta_total, filtered, and its rate
    tip: Array  #: (3,) latest measured tip [m]
    origin: Array  #: (3,) tip at the start, where setpoints count from [m]
    delta_1: Array  #: (3,) integral of C dw, eq. (22) [m]
    delta_2: Array  #: (3,) integral of (J(q, w) - J(q, 0)) dq, eq. (22) [m]


class Tick(NamedTuple):
    """Result of one tick: the command and everything worth plotting."""

    command: Array  #: (n,) joint velocities [rad/s or m/s]
    load: Fused
    deflection: Array  #: (3,) Delta_total as the models say it now [m]
    deflection_rate_raw: Array  #: (3,) its difference from the last tick, unfiltered [m/s]
    u_int: Array  #: (3,) what the outer loop asked for [m/s]
    setpoint: Setpoint
    sigma: Array  #: singular values of the Jacobian in use, joints in units of top speed [m/s]
    at_bound: Array  #: (n,) -1, 0, 1: joint held at its lower bound, free, at its upper
    memory: Memory


@dataclass(frozen=True)
class Controller:
    """What stays the same from tick to tick."""

    statics: Statics
    strategy: Strategy
    limits: Limits
    filter: RateFilter

    @property
    def period(self) -> float:
        """Time between ticks [s]."""
        return self.filter.period


def begin(controller: Controller, sample: Sample) -> Memory:
    """Memory before the first tick; the first sample must carry a tracker frame.

    Raises:
        PoseError, NoSolution, NotFinite: the model cannot start from this sample.

    """
    if sample.tip is None or not np.isfinite(sample.tip).all():
        raise NotFinite(f"measured tip {sample.tip} m: a finite tracker frame is needed to begin")
    load = fuse(sample.wrenches, *controller.statics.robot.tube_poses(sample.joints))
    loaded = controller.statics.solve(sample.joints, _point_force(load))
    unloaded = controller.statics.solve(sample.joints, np.zeros(6))
    deflection = controller.filter.start(loaded.tip - unloaded.tip)
    return Memory(loaded, unloaded, deflection, sample.tip, sample.tip, np.zeros(3), np.zeros(3))


def set_origin(memory: Memory, origin: Array) -> Memory:
    """Start a motion here: setpoints count from `origin` (3,) [m], the integrals of (22) from zero."""
    return memory._replace(origin=origin, delta_1=np.zeros(3), delta_2=np.zeros(3))


def step(controller: Controller, memory: Memory, sample: Sample, order: Setpoint | JointMotion | None) -> Tick:
    """One period: follow a setpoint, move joints as told, or (None) stand still; the estimates always go on.

    Raises:
        PoseError, NoSolution: the model cannot follow the measured pose and load.
        NotFinite: a measurement or the command is not finite; nothing of this tick may be sent.

    """
    robot, limits = controller.statics.robot, controller.limits
    load = fuse(sample.wrenches, *robot.tube_poses(sample.joints))
    loaded = controller.statics.solve(sample.joints, _point_force(load), memory.loaded)
    unloaded = controller.statics.solve(sample.joints, np.zeros(6), memory.unloaded)

    deflection = loaded.tip - unloaded.tip
    filtered = controller.filter.update(memory.deflection, deflection)
    delta_1, delta_2 = _deflection_parts(memory, loaded, unloaded)
    tip = memory.tip if sample.tip is None else sample.tip

    lower, upper = limits.velocity_bounds(sample.joints)
    if isinstance(order, Setpoint):
        setpoint = order
        u_int = controller.strategy.outer.tip_velocity(setpoint, tip - memory.origin)
        wanted = controller.strategy.inner(u_int, View(loaded, unloaded, filtered.rate))
        command, sigma, at_bound = inverse(wanted.jacobian, wanted.velocity, limits.speed, lower, upper)
    else:
        # Nothing is asked of the tip: it is where it should be.
        setpoint, u_int = Setpoint(tip - memory.origin, np.zeros(3)), np.zeros(3)
        asked = np.zeros(len(robot.joints)) if order is None else order.velocity
        command = np.minimum(np.maximum(asked, lower), upper)
        sigma, at_bound = np.zeros(min(3, len(robot.joints))), np.sign(asked - command)
    if not (np.isfinite(command).all() and np.isfinite(tip).all()):
        raise NotFinite(f"joint velocities {command.tolist()} at measured tip {tip.tolist()} m are not finite")

    return Tick(
        command, load, deflection, (deflection - (memory.loaded.tip - memory.unloaded.tip)) / controller.period,
        u_int, setpoint, sigma, at_bound,
        Memory(loaded, unloaded, filtered, tip, memory.origin, delta_1, delta_2),
    )  # fmt: skip


def _point_force(load: Fused) -> Array:
    """The measured load taken as a force at the tip, as the paper does: its moment is redundant."""
    return np.concatenate((load.force, np.zeros(3)))


def _deflection_parts(memory: Memory, loaded: Solution, unloaded: Solution) -> tuple[Array, Array]:
    """Delta_1 and Delta_2 of eq. (22), one trapezium further."""
    return (
        _trapezium(memory.delta_1, memory.loaded.compliance, loaded.compliance, loaded.wrench, memory.loaded.wrench),
        _trapezium(memory.delta_2, memory.loaded.jacobian, loaded.jacobian, loaded.joints, memory.loaded.joints)
        - _trapezium(np.zeros(3), memory.unloaded.jacobian, unloaded.jacobian, loaded.joints, memory.loaded.joints),
    )


@compiled
def _trapezium(total: Array, before: Array, after: Array, to: Array, start: Array) -> Array:
    """`total` (3,) + mean of two derivatives (3 or more rows) times the change of their variable."""
    result = total.copy()
    for i in range(3):
        for j in range(to.shape[0]):
            result[i] += 0.5 * (before[i, j] + after[i, j]) * (to[j] - start[j])
    return result
