"""Calibrated devices: corrections of every sample, and the total load from the base sensors.

The conversion between a base sensor's reading and the wrench of its tube includes the sensor's gain, its mounting, and
the weight of parts that hang on the sensor. The sensor's offset is excluded, because it is tared before every run. A
single sensor under the whole robot measures the sum of these wrenches, in the plate's axes at the plate's origin.

**Total load** (section V-A of the paper). Each base sensor measures its tube's share of the load plus the forces
between the tubes (friction, contact). In the sum over all sensors, in one frame, the forces between the tubes cancel
and the load remains. `tip_force` estimates the force at the tip from this sum.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array, Layout, Robot, sensor_poses, tube_poses


@dataclass(frozen=True)
class Sensors:
    """Gain errors and mounting of the base sensors, and weight of the parts that hang on them, without the tubes."""

    mounting: Array  #: (s, 3, 3) rotation from each sensor's axes to the axes of its tube, or of the plate
    weight: Array  #: (q,) weight that moves with each tube and hangs on a sensor [N]
    first_moment: Array  #: (q, 3) this weight times the position of its centre in the tube's axes [N m]
    #: (3,) direction of gravity in the plate's frame, unit vector
    gravity: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    #: (s, 6, 6) errors of gain and cross-talk: this matrix times the reading is subtracted from the reading; None:
    #: zero.
    skew: Array | None = None

    @cached_property
    def matrix(self) -> Array:
        """Matrices (s, 6, 6) that convert readings without offset to wrenches in the tubes' axes, weights included."""
        turn = np.zeros((len(self.mounting), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = self.mounting
        if self.skew is None:
            return turn
        return np.asarray(turn @ (np.eye(6) - self.skew), dtype=np.float64)

    @classmethod
    def ideal(cls, robot: Robot) -> "Sensors":
        """Return the sensors of a robot with exact gain and mounting, without hanging weight."""
        tubes = len(robot.tubes)
        return cls(np.tile(np.eye(3), (len(robot.sensor_names), 1, 1)), np.zeros(tubes), np.zeros((tubes, 3)))

    def exerted(self, robot: Robot, joints: Array, wrenches: Array) -> Array:
        """Return the wrenches (s, 6) in the tubes' or plate's axes from readings (s, 6) without offset."""
        return exerted(robot.layout, joints, wrenches, self.matrix, self.weight, self.first_moment, self.gravity)

    def hanging(self, robot: Robot, joints: Array) -> Array:
        """Return the readings (s, 6) that the hanging weight alone causes at joints (n,)."""
        weight = -self.exerted(robot, joints, np.zeros((len(self.mounting), 6)))
        return np.asarray(np.linalg.solve(self.matrix, weight[:, :, None])[:, :, 0], dtype=np.float64)


@compiled
def exerted(
    layout: Layout, joints: Array, wrenches: Array, matrix: Array, weight: Array, first_moment: Array, gravity: Array
) -> Array:
    """Compute `Sensors.exerted` in compiled code: the robot, readings (s, 6), then the sensors' parameters."""
    result = np.zeros_like(wrenches)
    alpha, beta, _ = tube_poses(layout, joints)
    for i in range(wrenches.shape[0]):
        for k in range(6):
            for m in range(6):
                result[i, k] += matrix[i, k, m] * wrenches[i, m]
    for i in range(layout.carried.shape[0]):
        tube: int = layout.carried[i]
        if tube >= 0:
            _subtract(result[i], weight[tube], first_moment[tube], alpha[tube], gravity)
            continue
        for k in range(alpha.shape[0]):  # the plate does not turn, but the centres of weight turn and slide
            cos, sin = np.cos(alpha[k]), np.sin(alpha[k])
            x, y, z = first_moment[k, 0], first_moment[k, 1], first_moment[k, 2]
            centre = np.array([cos * x - sin * y, sin * x + cos * y, z + weight[k] * beta[k]])
            _subtract(result[i], weight[k], centre, 0.0, gravity)
    return result


@compiled
def _subtract(wrench: Array, weight: float, first_moment: Array, alpha: float, gravity: Array) -> None:
    """Subtract a hanging weight from a wrench (6,) in axes that are turned by `alpha` relative to the plate."""
    cos, sin = np.cos(alpha), np.sin(alpha)
    gx, gy, gz = cos * gravity[0] + sin * gravity[1], cos * gravity[1] - sin * gravity[0], gravity[2]
    x, y, z = first_moment[0], first_moment[1], first_moment[2]
    wrench[0] -= weight * gx
    wrench[1] -= weight * gy
    wrench[2] -= weight * gz
    wrench[3] -= y * gz - z * gy
    wrench[4] -= z * gx - x * gz
    wrench[5] -= x * gy - y * gx


@dataclass(frozen=True)
class Corrections:
    """Calibrated offset and axis of the tracker coil, and calibrated base sensors."""

    sensors: Sensors
    #: (3,) position of the coil in the frame of the innermost tube's tip [m]
    coil: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array | None = None  #: (3,) coil axis in the tip's frame, unit vector; None: it is parallel to the tip

    def tip(self, coil: Array, rotation: Array) -> Array:
        """Return the tip (3,) for a coil measured at `coil` (3,) [m]; `rotation` (3, 3) is the tip's frame.

        The tip's frame comes from the model. With a coil offset of a millimetre, an error of this frame moves the tip
        by micrometres.
        """
        return coil - rotation @ self.coil

    def direction(self, axis: Array, rotation: Array) -> Array:
        """Return the tip's direction (3,) for a measured coil axis `axis` (3,); `rotation` (3, 3) is the tip's frame.

        The correction is the shortest rotation in the tip's frame that turns the coil's axis to z. The tip's frame
        comes from the model. With a coil axis misaligned by 3 degrees, a frame error of one degree causes a direction
        error of 0.05 degrees.
        """
        return axis if self.axis is None else rotation @ (self._straighten @ (rotation.T @ axis))

    def coil_axis(self, direction: Array, rotation: Array) -> Array:
        """Return the coil axis (3,) measured when the tip points along `direction`: inverse of `direction()`."""
        return direction if self.axis is None else rotation @ (self._straighten.T @ (rotation.T @ direction))

    @cached_property
    def _straighten(self) -> Array:
        """Shortest rotation (3, 3) that turns the coil's axis to the z axis of the tip's frame."""
        x, y, z = np.array([0.0, 0.0, 1.0]) if self.axis is None else self.axis
        part = 1.0 / (1.0 + z)
        return np.array([[1.0 - part * x * x, -part * x * y, -x], [-part * x * y, 1.0 - part * y * y, -y], [x, y, z]])

    def offset(self, robot: Robot, joints: Array, readings: Array) -> Array:
        """Return the tare (s, 6) from readings (s, 6) without load.

        The tare excludes the weight of parts that hang on the sensors, because these parts move relative to gravity.
        """
        return readings - self.sensors.hanging(robot, joints)


class FusedLoad(NamedTuple):
    """Total force and moment on the robot."""

    force: Array  #: (3,) total force [N]
    moment: Array  #: (3,) total moment about the plate's origin [N m]


def fuse(wrenches: Array, alpha: Array, beta: Array) -> FusedLoad:
    """Return the sum of the base wrenches in the plate's frame, at its origin.

    Args:
        wrenches: force and moment (s, 6) that each tube exerts on its sensor, in the sensor's
            axes [N, N m]. Sensor i is at (0, 0, beta_i) and turns with tube i.
        alpha: rotation of each sensor (s,) [rad].
        beta: position of each sensor along z (s,) [m].

    """
    total = _fuse(wrenches, alpha, beta)
    return FusedLoad(total[:3], total[3:])


def fuse_at(robot: Robot, joints: Array, wrenches: Array) -> FusedLoad:
    """Return the sum of the base wrenches at joints (n,) [rad or m], rotated into the world frame."""
    total = fused_at(robot.layout, joints, wrenches)
    return FusedLoad(total[:3], total[3:])


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
    plate = _fuse(wrenches, *sensor_poses(layout, joints))
    world = np.zeros(6)
    for i in range(3):
        for j in range(3):
            world[i] += layout.base[3 * i + j] * plate[j]
            world[3 + i] += layout.base[3 * i + j] * plate[3 + j]
    return world
