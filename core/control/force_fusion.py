"""Total load on the robot from the wrenches at the tubes' bases (section V-A of the paper).

Each base sensor measures its tube's share of the load plus the forces between the tubes (friction, contact). In the
sum over all sensors, in one frame, the forces between the tubes cancel and the load remains. `tip_force` estimates the
force at the tip from this sum.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array, Layout, Robot, tube_poses


class FusedLoad(NamedTuple):
    """Total force and moment on the robot."""

    force: Array  #: (3,) total force [N]
    moment: Array  #: (3,) total moment about the plate's origin [N m]


def fuse(wrenches: Array, alpha: Array, beta: Array) -> FusedLoad:
    """Return the sum of the base wrenches in the plate's frame, at its origin.

    Args:
        wrenches: force and moment (q, 6) that each tube exerts on its sensor, in the sensor's
            axes [N, N m]. Sensor i sits at (0, 0, beta_i) and turns with tube i.
        alpha: rotation of each tube (q,) [rad].
        beta: proximal end of each tube (q,) [m].

    """
    total = _fuse(wrenches, alpha, beta)
    return FusedLoad(total[:3], total[3:])


def fuse_at(robot: Robot, joints: Array, wrenches: Array) -> FusedLoad:
    """Return the sum of the base wrenches at joints (n,) [rad or m], rotated into the world frame."""
    total = fused_at(robot.layout, joints, wrenches)
    return FusedLoad(total[:3], total[3:])


def closure(load: FusedLoad, tip: Array) -> float:
    """Return the moment mismatch |moment - tip x force| [N m].

    The mismatch is zero for a point force at the tip (3,) [m], and large for other loads.
    """
    return float(np.linalg.norm(load.moment - np.cross(tip, load.force)))


@compiled
def _fuse(wrenches: Array, alpha: Array, beta: Array) -> Array:
    total = np.zeros(6)
    for i in range(alpha.shape[0]):
        c, s = np.cos(alpha[i]), np.sin(alpha[i])
        fx, fy = c * wrenches[i, 0] - s * wrenches[i, 1], s * wrenches[i, 0] + c * wrenches[i, 1]
        total[0] += fx
        total[1] += fy
        total[2] += wrenches[i, 2]
        total[3] += c * wrenches[i, 3] - s * wrenches[i, 4] - beta[i] * fy
        total[4] += s * wrenches[i, 3] + c * wrenches[i, 4] + beta[i] * fx
        total[5] += wrenches[i, 5]
    return total


@compiled
def fused_at(layout: Layout, joints: Array, wrenches: Array) -> Array:
    """Return force and moment (6,) of `fuse_at`, in compiled code."""
    alpha, beta, _ = tube_poses(layout, joints)
    plate = _fuse(wrenches, alpha, beta)
    world = np.zeros(6)
    for i in range(3):
        for j in range(3):
            world[i] += layout.base[3 * i + j] * plate[j]
            world[3 + i] += layout.base[3 * i + j] * plate[3 + j]
    return world
