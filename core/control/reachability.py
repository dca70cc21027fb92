"""Can the robot follow this motion? Walked on the model before anything moves.

From the start pose the joints take small steps of the same limit-aware inverse that the controller
uses, at the same speed limits, and nothing else: no noise, no delay. Where the tip falls behind its
path by more than a tolerance, the motion cannot be followed, and the limits active there say why.
"""

import math
from collections.abc import Callable

import numpy as np

from core.control.inverse import SIGMA_FLOOR, inverse
from core.control.pointing import PLACE, Aim, rows_of, turn
from core.control.trajectories import Directions, Trajectory
from core.errors import CtrError, Unreachable
from core.model.statics import Solution, Statics
from core.robot.limits import At, Limits
from core.robot.robot import Array

#: How far the tip may fall behind [m].
TOLERANCE = 5e-4
#: Between two steps of the walk, and how many there are at most [s].
STEP, MOST_STEPS = 0.02, 10_000
#: Singular values below this are named, though the damping sets in later [m/s].
NEAR_SINGULAR = 4.0 * SIGMA_FLOOR
#: Time to get to a path that does not begin at the start tip [s].
WAY_THERE = 20.0


def check_reach(
    statics: Statics, limits: Limits, joints: Array, trajectory: Trajectory, duration: float,
    force: Callable[[float], Array] | None = None, aim: Aim = PLACE, directions: Directions | None = None,
) -> None:  # fmt: skip
    """Refuse a motion that the robot cannot follow.

    Args:
        statics: the controller's model.
        limits: those of its joints and others.
        joints: start pose (n,) [rad or m].
        trajectory: offsets from the start tip.
        duration: of the motion [s]; what repeats itself is walked once.
        force: (3,) at the tip [N] by the time since the start [s], also what hangs there before it, at
            negative times; none when left out.
        aim: what of the tip is controlled. An angle counts as the way at its lever.
        directions: in which the tip points; none keeps that of the start.

    Raises:
        Unreachable: the first time at which the tip is off its path, by how much, and the limit.
        CtrError: the start pose itself cannot be.

    """
    limits.check(joints)
    walk = _Walk(statics, limits, joints, force, aim)
    start, heading = walk.at.tip, walk.at.rotation[:, 2]
    repeats = duration if force is not None else min(duration, trajectory.period)
    step = min(STEP, trajectory.period / 40.0) if trajectory.period > 0.0 else STEP
    before = np.zeros(3)
    for number in range(min(math.ceil(repeats / step), MOST_STEPS) + 1):
        time, (place, velocity, *_) = number * step, trajectory.setpoint(number * step)
        pointing = heading if directions is None else directions.at(time)[0]
        away = walk.step(start + place, time, step, pointing)
        if float(np.linalg.norm(place - before - step * velocity)) > TOLERANCE:
            # A jump is not followed but gone to; what counts is that it can be reached.
            for _ in range(round(WAY_THERE / step)):
                away = walk.step(start + place, time, step, pointing) if away > 0.1 * TOLERANCE else away
        before = place
        if away > TOLERANCE:
            raise Unreachable(
                f"cannot be followed: at {time:.4g} s the tip would be {1e3 * away:.2g} mm off"
                f" (more than {1e3 * TOLERANCE:g} mm) because of {walk.reasons}"
            ).at(time)


class _Walk:
    """A robot without inertia, noise and delay."""

    def __init__(
        self, statics: Statics, limits: Limits, joints: Array, force: Callable[[float], Array] | None, aim: Aim
    ) -> None:
        self._statics, self._limits, self._force, self._aim = statics, limits, force, aim
        self._reasons: tuple[str, ...] = ()
        self.at: Solution = statics.solve(joints, self._wrench(-STEP))

    def step(self, target: Array, time: float, length: float, pointing: Array) -> float:
        """Go for `length` [s] toward a tip (3,) [m] that points there (3,); how far it then is from it [m]."""
        at, limits = self.at, self._limits
        lower, upper = limits.velocity_bounds(at.joints)
        rows, room = None, np.zeros(0)
        if limits.others:
            rows, room = limits.rows(At(at.joints, at.jacobian[:3], at.tip, at.wrench[:3]))
        wrench = self._wrench(time)
        # What the load will do in this step belongs to what the joints have to make up for.
        moved = at.compliance[:, :3] @ (wrench[:3] - at.wrench[:3])
        wanted = rows_of(self._aim, (self._miss(target, pointing) - moved)[:, None] / length, at.rotation)[:, 0]
        jacobian = rows_of(self._aim, at.jacobian, at.rotation)
        found = inverse(jacobian, wanted, limits.speed, lower, upper, rows, room)
        self._reasons = limits.active(at.joints, found.at_bound, found.at_row)
        if found.sigma[-1] < NEAR_SINGULAR:
            self._reasons = (f"a singular pose (sigma {1e3 * found.sigma[-1]:.2g} mm/s)", *self._reasons)
        try:
            self.at = self._statics.solve(at.joints + length * found.velocity, wrench, at)
        except CtrError as error:
            raise Unreachable(f"at {time:.4g} s: {error}").at(time) from None
        return float(np.linalg.norm(rows_of(self._aim, self._miss(target, pointing)[:, None], self.at.rotation)))

    def _miss(self, target: Array, pointing: Array) -> Array:
        """(6,) way [m] and turn [rad] from the tip to where it should be."""
        return np.concatenate((target - self.at.tip, turn(self.at.rotation[:, 2], pointing)))

    @property
    def reasons(self) -> str:
        """What was in the way of the last step."""
        return ", ".join(self._reasons) or "more than the joints can do at once"

    def _wrench(self, time: float) -> Array:
        wrench = np.zeros(6)
        if self._force is not None:
            wrench[:3] = self._force(time)
        return wrench
