"""Retreat of the tubes from regions whose margin they miss, or will miss before a command takes effect.

The limits of velocities always allow zero velocity, so they cannot require a retreat. During a motion of the tip the
joint velocities therefore start from the retreat instead of zero: the inverse adds the velocity that moves the tip best
within the room that the retreat leaves.
"""

import numpy as np

from core.control.velocity_ik import VelocityTask, inverse
from core.robot.keep_out import KeepOut
from core.robot.limits import LimitContext, Limits
from core.robot.robot import Array

#: Largest speed of a retreat [m/s].
MAX_RETREAT_M_S = 0.005


def retreat(limits: Limits, at: LimitContext, rows: Array, room: Array) -> Array | None:
    """Return joint velocities (n,) that retreat from regions, as fast as all limits allow; None: none is necessary.

    Args:
        limits: limits of the robot.
        at: state of the robot.
        rows, room: rows (m, n) and room (m,) of `limits` there; the room is 0 where a retreat is necessary.
    """
    if room.all():
        return None
    missed: list[Array] = []
    speeds: list[Array] = []
    for limit in limits.others:
        if isinstance(limit, KeepOut):
            own, signed, _ = limit.evaluated(at.backbone)
            missed.append(own[signed < 0.0])
            speeds.append(signed[signed < 0.0])
    if not any(one.size for one in speeds):
        return None
    approach = np.maximum(np.concatenate(speeds), -MAX_RETREAT_M_S)
    bounds = limits.velocity_bounds(at.joints)
    return inverse(np.concatenate(missed), approach, limits.speed, *bounds, rows, room).velocity


def inverse_after_retreat(
    limits: Limits, joints: Array, task: VelocityTask, rows: Array, room: Array, retreating: Array | None
) -> tuple[Array, ...]:
    """Return velocity, singular values and active limits of `inverse`, whose velocity starts from a retreat (n,)."""
    lower, upper = limits.velocity_bounds(joints)
    if retreating is None:
        return tuple(inverse(*task, limits.speed, lower, upper, rows, room))
    left = room_after(retreating, rows, room)
    desired = task.velocity - task.jacobian @ retreating
    found = inverse(task.jacobian, desired, limits.speed, lower - retreating, upper - retreating, rows, left)
    return retreating + found.velocity, *found[1:]


def room_after(retreating: Array, rows: Array, room: Array) -> Array:
    """Return the room (m,) that a retreat (n,) leaves; where a retreat is necessary, nothing may slow it."""
    return np.where(room > 0.0, np.maximum(room - rows @ retreating, 0.0), 0.0)
