"""Second half of a tick: compute the joint velocities from the estimate, in one compiled call.

The steps are the outer loop, the inner loop, and the inverse of the Jacobian inside the limits. Custom loops in Python
can replace the outer and the inner loop. The inverse and the limits are the same for all strategies.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import compiled, copy
from core.control.controllers import (
    FeedbackOptions,
    LoopInputs,
    Strategy,
    Task,
    TaskInputs,
    custom_rows,
    inner_law,
    outer_law,
)
from core.control.estimation import Estimate, estimate_fields
from core.control.retreat import inverse_after_retreat, retreat, room_after
from core.control.tip_direction import POSITION_ONLY, DirectionTask, TaskSelection
from core.control.trajectories import Setpoint
from core.control.velocity_ik import (
    NO_BOUNDS,
    NullSpace,
    VelocityLimits,
    VelocityTask,
    inverse_law,
    no_rows,
    zero_velocity,
)
from core.errors import NotFinite
from core.model.solution import fields
from core.robot.limits import Backbone, Limits, velocity_bounds
from core.robot.robot import Array


class CommandResult(NamedTuple):
    """Joint velocities, the requested tip velocity, and the active limits."""

    velocity: Array  #: (n,) commanded joint velocities [rad/s or m/s]
    u_int: Array  #: (3,) tip velocity requested by the outer loop [m/s]
    sigma: Array  #: (min(3, n),) smallest singular values of the task's Jacobian times the joints' top speeds [m/s]
    at_bound: Array  #: (n,) -1: joint velocity at its lower bound; 0: free; 1: at its upper bound
    at_row: Array  #: (m,) 1 where a limit of several joints together is active


#: Empty array as default of the argument `drift`: the loops use the drift that the tip observer estimates.
OBSERVER_DRIFT = np.zeros(0)
#: Empty array in place of a retreat's joint velocities: no retreat is necessary.
NO_RETREAT = np.zeros(0)


#: Settings of the compiled control law, which reads them by name.
_SETTINGS = np.dtype([
    ("k1", float), ("k2", float), ("feedforward", float), ("inner", int),  # `Strategy.laws`
    ("lead_time", float), ("observes", bool), ("exact_rate", bool),  # `FeedbackOptions`
    ("weight", float), ("min_floor", float),  # `TaskSelection`: `position` and `floor`
])  # fmt: skip


@cache
def _settings(
    laws: tuple[float, float, float, int], feedback: FeedbackOptions, weight: float, min_floor: float
) -> NDArray[np.void]:
    """Return the settings of the compiled control law as an array with one record."""
    return np.array([(*laws, *feedback, weight, min_floor)], _SETTINGS)


@cache
def _nothing_else(n: int) -> tuple[VelocityTask, NullSpace]:
    """Return an empty task and an empty null-space objective for `n` joints: the defaults of `command`."""
    return VelocityTask(no_rows(n), NO_BOUNDS), NullSpace(zero_velocity(n), no_rows(n))


def command(
    strategy: Strategy, feedback: FeedbackOptions, limits: Limits,
    joints: Array, now: Estimate, force: Array, setpoint: Setpoint, tip: Array, origin: Array,
    drift: Array = OBSERVER_DRIFT,
    aim: TaskSelection = POSITION_ONLY, tasks: Sequence[Task] = (), null_space: NullSpace | None = None,
    near: Backbone | None = None,
) -> CommandResult:  # fmt: skip
    """Return the joint velocities that move the tip toward a setpoint.

    Args:
        strategy: outer and inner loop of the controller.
        feedback: measurements and estimates that the loops use.
        limits: limits of single joints and of several joints together.
        joints: measured joint positions (n,) [rad or m].
        now: estimate of this tick.
        force: estimated force on the tip (3,) [N].
        setpoint: desired tip, relative to `origin`.
        tip: tip position (3,) in the latest tracker frame [m].
        origin: position (3,) from which setpoints are measured [m].
        drift: tip velocity (3,) that neither joints nor load explain [m/s], or `OBSERVER_DRIFT`.
        aim: controlled coordinates of the tip; custom loops control the position only.
        tasks: control tasks in addition to the position; only built-in loops execute them.
        null_space: objective for joint motions that do not move the tip; None: the preferred joint velocity is zero.
        near: points along the loaded tubes, for the limits that keep the tubes out of regions.

    Raises:
        NotFinite: the requested tip velocity or the Jacobian is not finite.
        ContractError: a custom loop, task or limit raised, or returned a value that violates its interface.

    """
    n = joints.size
    rows, room, retreating = no_rows(n), NO_BOUNDS, None
    if limits.others:
        context = _CurrentConfiguration(joints, now, force, near)
        rows, room = limits.rows(context)
        if near is not None:
            retreating = retreat(limits, context, rows, room)
    if strategy.laws is None:
        u_int, task = _custom_loops(strategy, feedback, now, setpoint, tip, origin, drift)
        velocity, *found = inverse_after_retreat(limits, joints, task, rows, room, retreating)
        return CommandResult(velocity, u_int, *found)
    others, no_objective = _nothing_else(n)
    null_space = no_objective if null_space is None else null_space
    if tasks:
        inputs = TaskInputs(strategy.laws, feedback, now.loaded, now.unloaded)
        parts = [task.rows(inputs) if type(task) is DirectionTask else custom_rows(task, inputs) for task in tasks]
        others = VelocityTask(*(np.concatenate(sides) for sides in zip(*parts, strict=True)))
    found = CommandResult(np.empty(n), np.empty(3), np.empty(min(3, n)), np.empty(n), np.empty(room.size))
    if not _command(
        _settings(strategy.laws, feedback, aim.position, aim.floor),
        limits.packed, joints, now.loaded.numbers, now.unloaded.numbers, now.numbers,
        setpoint.position, setpoint.velocity, tip, origin, drift, *others,
        NO_RETREAT if retreating is None else retreating,
        rows, room if retreating is None else room_after(retreating, rows, room), *null_space, *found,
    ):  # fmt: skip
        raise NotFinite(f"requested tip velocity {found.u_int.tolist()} m/s or the Jacobian is not finite")
    return found


def joint_command(
    limits: Limits, joints: Array, now: Estimate, force: Array, requested: Array, near: Backbone | None = None
) -> CommandResult:
    """Return the `requested` joint velocity (n,), reduced to the limits; `force` (3,) is the force on the tip [N].

    Each joint can still stop inside its travel. A limit of several joints slows all joints by the same factor, so the
    path in joint space does not change.

    Raises:
        ContractError: a custom limit raised, or returned a value that violates its interface.

    """
    lower, upper = limits.velocity_bounds(joints)
    velocity = np.minimum(np.maximum(requested, lower), upper)
    at_bound, at_row = np.sign(requested - velocity), NO_BOUNDS
    if limits.others and velocity.any():
        rows, room = limits.rows(_CurrentConfiguration(joints, now, force, near))
        toward = rows @ velocity
        at_row = (toward > room).astype(float)
        if at_row.any():
            velocity = velocity * np.min(room[at_row > 0.0] / toward[at_row > 0.0])
    return CommandResult(velocity, np.zeros(3), np.zeros(min(3, requested.size)), at_bound, at_row)


class _CurrentConfiguration:
    """State of the robot in one tick, for limits; Jacobian and tip are computed only when a limit reads them."""

    __slots__ = ("_near", "_now", "force", "joints")

    def __init__(self, joints: Array, now: Estimate, force: Array, near: Backbone | None) -> None:
        self.joints, self._now, self.force, self._near = joints, now, force, near

    @property
    def jacobian(self) -> Array:
        """Jacobian (3, n) of the loaded tip's position [m/rad or m/m]."""
        return self._now.loaded.jacobian[:3]

    @property
    def tip(self) -> Array:
        """Observed tip position (3,) [m]."""
        return self._now.observed.tip

    @property
    def backbone(self) -> Backbone:
        """Points along the loaded tubes, bent to the observed tip."""
        assert self._near is not None, "the limit of a region needs the points along the tubes"  # noqa: S101
        return self._near


def _custom_loops(
    strategy: Strategy,
    feedback: FeedbackOptions,
    now: Estimate,
    setpoint: Setpoint,
    tip: Array,
    origin: Array,
    drift: Array,
) -> tuple[Array, VelocityTask]:
    """Call custom loops; return the requested tip velocity U_int (3,) and the equation for the joints.

    The loops receive copies of all arrays and may overwrite the copies.
    """
    known = now.known
    aim = Setpoint(_setpoint_ahead(feedback.lead_time, setpoint.position, setpoint.velocity), setpoint.velocity.copy())
    u_int = strategy.tip_velocity(aim, (known.tip_ahead if feedback.observes else tip) - origin)
    rate = known.deflection_rate_exact if feedback.exact_rate else known.deflection_rate
    drift = known.drift if drift.size == 0 else drift
    view = LoopInputs(now.loaded.copy(), now.unloaded.copy(), rate.copy(), known.load_rate.copy(), drift.copy())
    return u_int, strategy.velocity_task(u_int.copy(), view)


@compiled
def _setpoint_ahead(lead_time: float, desired: Array, velocity: Array) -> Array:
    """Return the setpoint's position (3,) at the time when a command sent now takes effect [m]."""
    aim = np.empty(3)
    for i in range(3):
        aim[i] = desired[i] + lead_time * velocity[i]
    return aim


@compiled
def _stacked(weight: float, position: VelocityTask, rows: Array, velocity: Array) -> VelocityTask:
    """Return the weighted rows of the position (none if its weight is 0), then the rows of the other tasks."""
    first, n = 3 if weight > 0.0 else 0, rows.shape[1]
    jacobian, sides = np.empty((first + velocity.size, n)), np.empty(first + velocity.size)
    for i in range(sides.size):
        sides[i] = weight * position.velocity[i] if i < first else velocity[i - first]
        for j in range(n):
            jacobian[i, j] = weight * position.jacobian[i, j] if i < first else rows[i - first, j]
    return VelocityTask(jacobian, sides)


@compiled
def _command(
    settings: NDArray[np.void], limits: Array, joints: Array, loaded: Array, unloaded: Array, estimate: Array,
    desired: Array, velocity: Array, tip: Array, origin: Array, drift: Array, task_rows: Array, task_velocity: Array,
    retreating: Array, rows: Array, room: Array, preferred: Array, resisted: Array,
    command: Array, u_int: Array, sigma: Array, at_bound: Array, at_row: Array,
) -> bool:  # fmt: skip
    """Compute `command` with built-in loops into the last five arguments; return False if an input is not finite."""
    law, now, here = settings[0], estimate_fields(estimate), np.empty(3)
    for i in range(3):
        here[i] = (now.tip_ahead[i] if law.observes else tip[i]) - origin[i]
    aim = _setpoint_ahead(law.lead_time, desired, velocity)
    copy(outer_law(law.k1, law.k2, law.feedforward, aim, velocity, here), u_int)
    rate = now.deflection_rate_exact if law.exact_rate else now.deflection_rate
    unexplained = now.drift if drift.size == 0 else drift
    task = VelocityTask(
        *inner_law(
            law.inner, u_int, fields(loaded).jacobian, fields(unloaded).jacobian, rate, now.load_rate, unexplained
        )
    )
    if task_velocity.size > 0:
        task = _stacked(law.weight, task, task_rows, task_velocity)
    lower, upper = velocity_bounds(joints, limits)
    if retreating.size > 0:  # solve for the velocity that is added to the retreat
        task = VelocityTask(task.jacobian, task.velocity.copy())
        for j in range(retreating.size):
            lower[j] -= retreating[j]
            upper[j] -= retreating[j]
            for i in range(task.velocity.size):
                task.velocity[i] -= task.jacobian[i, j] * retreating[j]
    bounds = VelocityLimits(limits[2], lower, upper, rows, room)
    found, values, bounded, active, finite = inverse_law(task, bounds, NullSpace(preferred, resisted), law.min_floor)
    copy(found, command)
    for j in range(retreating.size):
        command[j] += retreating[j]
    for i in range(sigma.shape[0]):
        sigma[i] = values[max(0, values.shape[0] - sigma.shape[0] + i)]
    copy(bounded, at_bound)
    copy(active, at_row)
    return finite
