"""Retreat from regions: tubes nearer to a region than its margin, now or before a command takes effect, move away.

Velocity limits always allow zero velocity, so they cannot require a retreat. During a motion of the tip, the controller
therefore computes the joint velocities of the retreat first. The inverse then adds the velocities that move the tip
best within the limits that the retreat leaves.

Near a singular pose two joints may turn fast against each other while the tubes slide along a wall. If the direction
of the slide reverses, the joints must reach their new velocities at the same time (`within_acceleration`). Otherwise
one joint would reach its new velocity first, and the other one would push the tubes into the wall.

The depth from which a retreat starts bounds its length (`continued_retreat`). A longer retreat means that the region is
not where the controller assumes it, or that something keeps pushing the tubes. Then the operator must decide.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.velocity_ik import VelocityTask, inverse
from core.errors import PoseError
from core.robot.keep_out import RETREAT_TIME_S, TOLERANCE_M, KeepOut, smallest_clearance
from core.robot.limits import Backbone, LimitContext, Limits
from core.robot.robot import Array

#: Largest speed of a retreat [m/s].
MAX_RETREAT_M_S = 0.005
#: Distance that a retreat may go beyond its depth [m], because the stages and the observed tubes follow with a delay.
MAX_BEYOND_M = 1e-3
#: Time that a retreat may take in addition to 2 depth / `MAX_RETREAT_M_S` [s].
MAX_EXTRA_TIME_S = 2.0


class RetreatCourse(NamedTuple):
    """Progress of a retreat, which lasts while the tubes are more than `TOLERANCE_M` inside a region's margin."""

    depth: float = 0.0  #: largest depth of the tubes inside the margin so far; a load may increase it [m]
    distance: float = 0.0  #: distance commanded since the start of the retreat [m]
    duration: float = 0.0  #: time since the start of the retreat [s]


#: No retreat in progress.
NO_RETREAT = RetreatCourse()


def continued_retreat(
    last: RetreatCourse, clearance: float, period: float, regions: Sequence[KeepOut], near: Backbone
) -> RetreatCourse:
    """Return a retreat's progress one tick of `period` [s] later; `clearance` is that of the tubes `near` [m].

    Raises:
        PoseError: the retreat has gone farther, or has lasted longer, than its depth allows.
    """
    if clearance > -TOLERANCE_M:
        return NO_RETREAT
    speed = min(-clearance / RETREAT_TIME_S, MAX_RETREAT_M_S)
    now = RetreatCourse(max(last.depth, -clearance), last.distance + period * speed, last.duration + period)
    farthest, longest = now.depth + MAX_BEYOND_M, 2.0 * now.depth / MAX_RETREAT_M_S + MAX_EXTRA_TIME_S
    if now.distance <= farthest and now.duration <= longest:
        return now
    nearest = smallest_clearance(regions, near)
    name = "" if nearest is None else nearest[0]
    raise PoseError(
        f"the retreat from the region '{name}' has gone {1e3 * now.distance:.2g} mm in {now.duration:.2g} s from a"
        f" depth of {1e3 * now.depth:.2g} mm (at most {1e3 * farthest:.2g} mm in {longest:.2g} s);"
        " check the region in the scene, take the load off, and jog the joints away"
    )


def retreat(limits: Limits, at: LimitContext, rows: Array, room: Array) -> Array | None:
    """Return joint velocities (n,) that retreat from regions, as fast as all limits allow; None: no need to retreat.

    Args:
        limits: limits of the robot.
        at: state of the robot.
        rows, room: rows (m, n) and room (m,) from `limits.rows(at)`; the room is 0 where a retreat is necessary.
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
    """Return velocity (a retreat (n,) plus the velocity of `inverse`), singular values and active limits."""
    lower, upper = limits.velocity_bounds(joints)
    if retreating is None:
        return tuple(inverse(*task, limits.speed, lower, upper, rows, room))
    left = room_after(retreating, rows, room)
    desired = task.velocity - task.jacobian @ retreating
    found = inverse(task.jacobian, desired, limits.speed, lower - retreating, upper - retreating, rows, left)
    return retreating + found.velocity, *found[1:]


def room_after(retreating: Array, rows: Array, room: Array) -> Array:
    """Return the room (m,) that the joint velocities (n,) of a retreat leave; it is 0 in rows that need the retreat."""
    return np.where(room > 0.0, np.maximum(room - rows @ retreating, 0.0), 0.0)


def within_acceleration(limits: Limits, at: LimitContext, sent: Array, velocity: Array, interval: float) -> Array:
    """Return joint velocities (n,) between those sent last and the desired ones that all joints reach at the same time.

    Otherwise a joint with a small change of velocity would complete it before the other joints. Until these follow, the
    tubes would move in a direction that the limits forbid. Every velocity between two allowed ones is allowed, too. If
    limits and accelerations conflict, the limits are kept.

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
    """Return the part (0 ... 1) of a velocity change that the joints can follow, or the larger part that limits need.

    `largest` (n,) contains the largest change of each joint's velocity within the interval [rad/s or m/s].
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
