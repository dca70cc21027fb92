"""Reachability check: simulate a motion on the model, before the robot moves, to see whether the robot can follow it.

From the start pose, the simulated joints take small steps with the controller's inverse, inside the same limits,
without noise and delay. If the tip falls behind its path by more than a tolerance, the robot cannot follow the motion.
The limits that are active at that time are reported as the reason.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from core.compiled import compiled, merged
from core.control.retreat import inverse_after_retreat, retreat
from core.control.tip_direction import POSITION_ONLY, TaskSelection, shortest_rotation_law
from core.control.trajectories import Directions, Trajectory
from core.control.velocity_ik import NO_BOUNDS, SIGMA_FLOOR_M_S, VelocityTask, no_rows
from core.errors import Cancelled, CtrError, PoseError, Unreachable
from core.model.backbone import ExpectedMotion, backbone
from core.model.solution import fields
from core.model.statics import Solution, Statics
from core.robot.keep_out import KeepOut
from core.robot.limits import Backbone, Limits
from core.robot.robot import Array

#: Largest distance by which the simulated tip may fall behind its path [m].
MAX_LAG_M = 5e-4
#: Time between two steps of the reachability check [s], and largest number of its steps.
CHECK_INTERVAL_S, MAX_STEPS = 0.02, 10_000
#: Singular value of the Jacobian below which a singular pose is reported as a reason [m/s]; damping starts lower.
NEAR_SINGULAR_M_S = 4.0 * SIGMA_FLOOR_M_S
#: Time that the tip has to reach the path after a jump [s].
APPROACH_TIME_S = 20.0


class SolvedConfiguration:
    """Limit context of a solved pose."""

    def __init__(
        self, statics: Statics, at: Solution, tip: Array | None = None, expected: ExpectedMotion | None = None
    ) -> None:
        """Store a solution; `tip` is the observed position of the tip (3,) [m], by default the model's.

        `expected` is the motion that joint velocities cannot change; None: the robot is at rest.
        """
        self._statics, self._at, self._observed, self._expected = statics, at, tip, expected
        self.joints, self.force = at.joints, at.wrench[:3]
        self._backbone: Backbone | None = None

    @property
    def jacobian(self) -> Array:
        """Jacobian (3, n) of the loaded tip's position [m/rad or m/m]."""
        return self._at.jacobian[:3]

    @property
    def tip(self) -> Array:
        """Position of the tip (3,) [m]."""
        return self._at.tip if self._observed is None else self._observed

    @property
    def backbone(self) -> Backbone:
        """Points along the loaded tubes."""
        if self._backbone is None:
            self._backbone = backbone(self._statics, self._at, self._observed, self._expected)
        return self._backbone


@dataclass(frozen=True)
class _Unloaded:
    """Limit context of a pose without load; the model solves the pose only when a limit reads the tip."""

    statics: Statics
    joints: Array

    @cached_property
    def _at(self) -> SolvedConfiguration:
        return SolvedConfiguration(self.statics, self.statics.solve(self.joints, np.zeros(6)))

    @property
    def jacobian(self) -> Array:
        """Jacobian (3, n) of the tip's position [m/rad or m/m]."""
        return self._at.jacobian

    @property
    def tip(self) -> Array:
        """Position of the tip (3,) [m]."""
        return self._at.tip

    @property
    def force(self) -> Array:
        """Zero force (3,) [N]: the pose is unloaded."""
        return np.zeros(3)

    @property
    def backbone(self) -> Backbone:
        """Points along the unloaded tubes."""
        return self._at.backbone


def check_pose(statics: Statics, limits: Limits, joints: Array) -> None:
    """Reject joint positions (n,) [rad or m] that violate a limit of travel, tubes or workspace without load.

    Raises:
        PoseError: a limit is violated; the text has the limit, the value and the bound.
        CtrError: the model has no shape at these joint positions.

    """
    limits.check(joints)
    statics.robot.check_pose(joints)
    limits.check_all(_Unloaded(statics, joints))


def check_reach(
    statics: Statics, limits: Limits, joints: Array, trajectory: Trajectory, duration: float,
    force: Callable[[float], Array] | None = None, aim: TaskSelection = POSITION_ONLY,
    directions: Directions | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> None:  # fmt: skip
    """Simulate a motion and raise an error if the robot cannot follow it.

    Args:
        statics: model of the controller.
        limits: limits of single joints and of several joints together.
        joints: start pose (n,) [rad or m].
        trajectory: desired offsets from the start tip.
        duration: duration of the motion [s]; a periodic motion is checked for one period after the direction has become
            constant.
        force: function that returns the tip force (3,) [N] at a time since the start [s]; times before the start are
            negative; None: no force.
        aim: controlled coordinates of the tip. An angular error counts as the distance angle times lever.
        directions: desired directions of the tip; None: the tip keeps its start direction.
        cancelled: function that returns whether the result is no longer required; the check calls it at every step.

    Raises:
        Cancelled: `cancelled` returned true.
        Unreachable: the tip leaves its path; the text has the first time, the distance, and the limit.
        CtrError: the start pose itself is invalid.

    """
    limits.check(joints)
    walk = _Walk(statics, limits, joints, force, aim)
    limits.check_all(SolvedConfiguration(statics, walk.at))
    start, heading = walk.at.tip, walk.at.rotation[:, 2]
    turns = 0.0 if directions is None else max(directions.times[-1], 0.0)  # afterwards the direction is constant
    repeats = duration if force is not None else min(duration, turns + trajectory.period)
    step = min(CHECK_INTERVAL_S, trajectory.period / 40.0) if trajectory.period > 0.0 else CHECK_INTERVAL_S
    before = np.zeros(3)
    for number in range(math.ceil(min(repeats / step, MAX_STEPS)) + 1):
        if cancelled():
            raise Cancelled
        time, (offset, velocity, *_) = number * step, trajectory.setpoint(number * step)
        pointing = heading if directions is None else directions.at(time)[0]
        away = walk.step(start + offset, time, step, pointing)
        if float(np.linalg.norm(offset - before - step * velocity)) > MAX_LAG_M:
            # No robot can follow a jump of the path; the check accepts the jump if the tip can reach the jump's end.
            for _ in range(round(APPROACH_TIME_S / step)):
                if cancelled():
                    raise Cancelled
                away = walk.step(start + offset, time, step, pointing) if away > 0.1 * MAX_LAG_M else away
        before = offset
        if away > MAX_LAG_M:
            raise Unreachable(
                f"cannot be followed: at {time:.4g} s the tip would {walk.error} because of {walk.reasons}"
            ).at(time)


class _Walk:
    """Simulation of the model along a motion, without inertia, noise and delay."""

    def __init__(
        self,
        statics: Statics,
        limits: Limits,
        joints: Array,
        force: Callable[[float], Array] | None,
        aim: TaskSelection,
    ) -> None:
        self._statics, self._limits, self._force = statics, limits, force
        self._position, self._lever, self._rows = aim.position, aim.lever, aim.rows
        self._regions = tuple(limit for limit in limits.others if isinstance(limit, KeepOut))
        self._last: tuple[Array, ...]  # joint positions before the last step, then singular values and active limits
        self._left = (0.0, 0.0)  # remaining distance [m], and remaining angle times lever [m]
        self.at: Solution = statics.solve(joints, self._wrench(-CHECK_INTERVAL_S))

    def step(self, target: Array, time: float, length: float, pointing: Array) -> float:
        """Move for `length` [s] toward a target (3,) [m] and direction (3,); return the distance that remains [m]."""
        at, limits, n = self.at, self._limits, self.at.joints.size
        wrench = self._wrench(time)
        rows, room, retreating = no_rows(n), NO_BOUNDS, None
        if limits.others:
            expected = ExpectedMotion(np.zeros(n), (wrench[:3] - at.wrench[:3]) / length, np.zeros(3), lead_time=0.0)
            context = SolvedConfiguration(self._statics, at, expected=expected)
            rows, room = limits.rows(context)
            retreating = retreat(limits, context, rows, room)
        task = VelocityTask(np.zeros((self._rows, n)), np.zeros(self._rows))
        _fill_task(at.numbers, wrench, target, pointing, self._position, self._lever, length, *task)
        velocity, *found = inverse_after_retreat(limits, at.joints, task, rows, room, retreating)
        self._last = at.joints, *found
        try:
            self.at = self._statics.solve(at.joints + length * velocity, wrench, at)
        except CtrError as error:
            raise Unreachable(f"at {time:.4g} s: {error}").at(time) from None
        if self._regions:
            self._check_regions(time)
        self._left = _remaining(self.at.numbers, target, pointing, self._position, self._lever)
        return math.hypot(*self._left)

    def _check_regions(self, time: float) -> None:
        """Reject a pose at which a load has pushed the tubes into a region; velocity limits do not prevent this."""
        context = SolvedConfiguration(self._statics, self.at)
        for region in self._regions:
            try:
                region.check(context)
            except PoseError as error:
                raise Unreachable(f"at {time:.4g} s: {error}").at(time) from None

    @property
    def error(self) -> str:
        """Text: how far the tip is from its path after the last step, in the controlled coordinates."""
        (position, angle), lever = self._left, self._lever
        parts: list[str] = []
        if self._position and (not lever or position >= MAX_LAG_M or position >= angle):
            parts.append(f"be {1e3 * position:.2g} mm off (more than {1e3 * MAX_LAG_M:g} mm)")
        if lever and (not self._position or angle >= MAX_LAG_M or angle > position):
            deviation, largest = (math.degrees(part / lever) for part in (angle, MAX_LAG_M))
            parts.append(f"point {deviation:.2g} deg off (more than {largest:.2g} deg)")
        return " and ".join(parts)

    @property
    def reasons(self) -> str:
        """Text: the limits that were active in the last step."""
        joints, sigma, *active = self._last
        names = self._limits.active(joints, *active)
        if sigma[-1] < NEAR_SINGULAR_M_S:
            names = (f"a singular pose (sigma {1e3 * sigma[-1]:.2g} mm/s)", *names)
        return ", ".join(names) or "the speed of the motion; slow it down"

    def _wrench(self, time: float) -> Array:
        wrench = np.zeros(6)
        if self._force is not None:
            wrench[:3] = self._force(time)
        return wrench


@compiled
def _fill_task(
    numbers: Array, wrench: Array, target: Array, pointing: Array, position: float, lever: float, length: float,
    jacobian: Array, desired: Array,
) -> None:  # fmt: skip
    """Add the equations for the joint velocities of a step to `jacobian` and `desired`, which are zero before.

    Args:
        numbers: numbers of the solution before the step.
        wrench, target, pointing: load (6,), position (3,) [m] and direction (3,) of the tip after the step.
        position, lever: weights of the task, see `TaskSelection`.
        length: duration of the step [s].
        jacobian, desired: out, see `VelocityTask`.

    """
    at = fields(numbers)
    n, split = at.joints.shape[0], 3 if position > 0.0 else 0
    moved, turned = np.empty(3), shortest_rotation_law(_axis(at.rotation), pointing)
    for i in range(3):
        # The joints must also compensate the motion that the load causes in this step.
        moved[i] = target[i] - at.tip[i]
        for j in range(6):
            moved[i] -= at.compliance[i, j] * (wrench[j] - at.wrench[j])
            turned[i] -= at.compliance[3 + i, j] * (wrench[j] - at.wrench[j])
    for k in range(desired.shape[0]):
        for i in range(3):
            if k < split:
                weight, row, change = position if i == k else 0.0, i, moved[i]
            else:
                weight, row, change = lever * at.rotation[i, k - split], 3 + i, turned[i]
            desired[k] += weight * change / length
            for j in range(n):
                jacobian[k, j] += weight * at.jacobian[row, j]


@compiled
def _remaining(numbers: Array, target: Array, pointing: Array, position: float, lever: float) -> tuple[float, float]:
    """Return the weighted distance from the tip to the target [m], and the angle times `lever` [m]."""
    at = fields(numbers)
    distance, angle, turn = 0.0, 0.0, shortest_rotation_law(_axis(at.rotation), pointing)
    for i in range(3):
        distance += (target[i] - at.tip[i]) ** 2
    for k in range(2):
        component = 0.0
        for i in range(3):
            component += at.rotation[i, k] * turn[i]
        angle += component * component
    return position * np.sqrt(distance), lever * np.sqrt(angle)


@merged
def _axis(rotation: Array) -> Array:
    """Return the third column (3,) of a frame (3, 3), the direction of the tip."""
    return np.array((rotation[0, 2], rotation[1, 2], rotation[2, 2]))
