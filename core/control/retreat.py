"""Motion near regions: the retreat of tubes that miss a margin or will miss it before a command takes effect.

The limits of velocities always allow zero velocity, so they cannot require a retreat. During a motion of the tip the
joint velocities therefore start from the retreat instead of zero: the inverse adds the velocity that moves the tip best
within the room that the retreat leaves.

Near a singular pose two joints may turn fast against each other while the tubes slide along a wall. If the direction
of the slide reverses, the joints must change their velocities together (`within_acceleration`). Otherwise the first
joint that reaches its new velocity would let the other one push the tubes into the wall.
"""

import numpy as np

from core.compiled import compiled
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
            found = limit.evaluated(at.backbone)
            missed.append(found.rows[found.room < 0.0])
            speeds.append(found.room[found.room < 0.0])
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


def within_acceleration(limits: Limits, at: LimitContext, sent: Array, velocity: Array, interval: float) -> Array:
    """Return joint velocities (n,) that all joints can reach together, from those sent last toward the desired ones.

    A joint with a smaller change of velocity would otherwise reach it before the other joints. Until these follow, the
    tubes would move in a direction that no limit allows. Limits allow all velocities between two that they allow. They
    are never missed for the sake of the accelerations.

    Args:
        limits: limits of the robot.
        at: state of the robot.
        sent: velocities sent to the stages last (n,) [rad/s or m/s].
        velocity: desired velocities (n,), which the limits allow [rad/s or m/s].
        interval: time between two commands to the same joint [s].
    """
    change, largest = velocity - sent, interval * limits.packed[3]
    if (np.abs(change) <= largest).all():
        return velocity
    share = _share_of_change(*limits.velocity_bounds(at.joints), *limits.rows(at), largest, sent, velocity)
    return sent + share * change


@compiled
def _share_of_change(
    lower: Array, upper: Array, rows: Array, room: Array, largest: Array, sent: Array, velocity: Array
) -> float:
    """Return the share of a change of velocities that the joints can follow, or that the limits need if it is more.

    `largest` (n,) are the changes within the interval [rad/s or m/s].
    """
    share, needed = 1.0, 0.0
    for j in range(sent.size):
        change = velocity[j] - sent[j]
        if abs(change) > largest[j]:
            share = min(share, largest[j] / abs(change))
        if sent[j] > upper[j]:
            needed = max(needed, (sent[j] - upper[j]) / max(-change, 1e-12))
        if sent[j] < lower[j]:
            needed = max(needed, (lower[j] - sent[j]) / max(change, 1e-12))
    for i in range(room.size):
        before, after = 0.0, 0.0
        for j in range(sent.size):
            before += rows[i, j] * sent[j]
            after += rows[i, j] * velocity[j]
        if before > room[i]:
            needed = max(needed, (before - room[i]) / max(before - after, 1e-12))
    return max(share, min(needed, 1.0))
