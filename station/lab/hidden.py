"""What a new bench does not know about itself: frames, zeros, mountings, late clocks.

Each of these is nothing unless the lab's configuration says otherwise; the sizes are then the
configuration's and the directions come from the seed. Calibration has to find them out from the
devices alone.
"""

import math
from dataclasses import replace

import numpy as np

from core.calibration.rigid import rotation_of, vector_of
from core.robot.robot import Array, Base, Robot
from station.config.robots import RobotFile
from station.devices.aurora.tracker import Registration
from station.lab.config import HiddenConfig, TrackerConfig

#: Where the parts of a sensor that hang on it have their weight, in the tube's axes [m].
HANGING = np.array([0.002, -0.001, 0.015])


class Hidden:
    """Errors drawn once for a lab."""

    def __init__(self, robot: RobotFile, config: HiddenConfig, rng: np.random.Generator) -> None:
        description = robot.robot()
        q, joints = len(description.tubes), description.joints
        angle, way, tilt, shift = (_direction(rng) for _ in range(4))
        self._generator = Registration(
            rotation_of(config.registration_rotation * angle), config.registration_translation * way
        )
        self._base = Base(tuple((config.base_position * shift).tolist()), tuple((config.base_rotation * tilt).tolist()))
        self.coil = np.array(config.coil_offset)  #: (3,) in the frame of the tip [m]
        self.askew = config.coil_askew > 0.0  #: the coil's axis is not the tip's
        # From a stream of its own, so that the rest is the same with and without.
        about = float(rng.spawn(1)[0].uniform(-math.pi, math.pi))
        turn = rotation_of(config.coil_askew * np.array([math.cos(about), math.sin(about), 0.0]))
        self.coil_axis: Array = turn[:, 2].copy()  #: (3,) in the frame of the tip
        self.late = config.tracker_latency  #: on top of what the tracker is said to have [s]
        random = rng.uniform(-1.0, 1.0, len(joints))
        turns = np.array([joint.motion == "rotation" for joint in joints])
        self._zero = random * np.where(turns, config.rotation_zero, config.translation_zero)
        # The outermost tube's zero angle says where x of the robot's frame points.
        outermost = [k for k, joint in enumerate(joints) if joint.motion == "rotation" and joint.tube == q - 1]
        self._zero[outermost] = 0.0
        self._sign = np.array([-1.0 if joint.name in config.mirrored else 1.0 for joint in joints])
        middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
        self._shift = np.where(self._sign < 0.0, 2.0 * middle, 0.0) + self._zero
        self._off = bool(self._shift.any() or (self._sign < 0.0).any())
        self._askew = [rotation_of(config.sensor_mounting * _direction(rng)).T for _ in range(q)]
        self._weight = config.sensor_weight
        self._tube_of = {joint.tube: k for k, joint in enumerate(joints) if joint.motion == "rotation"}
        self.felt_as_is = config.sensor_mounting == 0.0 and config.sensor_weight == 0.0
        self._rest = np.array([tube.rotation for tube in description.tubes])

    def robot(self, robot: Robot) -> Robot:
        """The robot on a plate that stands a little off."""
        if not any((*self._base.position, *self._base.rotation_vector)):
            return robot
        turned = Base(robot.base.position, self._base.rotation_vector)
        rotation = turned.rotation @ robot.base.rotation
        position = np.array(robot.base.position) + np.array(self._base.position)
        return replace(robot, base=Base(tuple(position.tolist()), _vector(rotation)))

    def joints(self, positions: Array) -> Array:
        """Where the joints really are (n,) when the stages count `positions` (n,)."""
        return self._sign * positions + self._shift if self._off else positions

    def mount(self, mount: Registration) -> Registration:
        """Where the field generator really stands when it is said to stand at `mount`."""
        return Registration(
            self._generator.rotation @ mount.rotation,
            self._generator.rotation @ mount.position + self._generator.position,
        )

    def tracker(self, config: TrackerConfig) -> TrackerConfig:
        """The tracker with the delay that nobody told."""
        return config.model_copy(update={"latency": config.latency + self.late}) if self.late else config

    def felt(self, wrenches: Array, joints: Array) -> Array:
        """What the sensors feel (q, 6) when the tubes exert `wrenches` (q, 6), in the sensors' real axes."""
        result = np.empty_like(wrenches)
        for i, wrench in enumerate(wrenches):
            angle = joints[self._tube_of[i]] if i in self._tube_of else self._rest[i]
            weight = self._weight * np.array([math.cos(angle), -math.sin(angle), 0.0])  # gravity is +x
            result[i, :3] = self._askew[i] @ (wrench[:3] + weight)
            result[i, 3:] = self._askew[i] @ (wrench[3:] + np.cross(HANGING, weight))
        return result


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.standard_normal(3)
    return vector / float(np.linalg.norm(vector))


def _vector(rotation: Array) -> tuple[float, float, float]:
    x, y, z = vector_of(rotation).tolist()
    return (x, y, z)
