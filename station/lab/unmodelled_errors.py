"""Errors of a simulated bench that the station does not know: in frames, zeros, mountings and latency.

Each error is zero by default. The lab's configuration sets the sizes, and the seed determines the directions.
Calibration has to find these errors from the devices' data alone.
"""

import math
from dataclasses import replace

import numpy as np

from core.calibration.rigid_transform import rotation_from_vector, vector_from_rotation
from core.robot.robot import Array, Base, Robot
from station.config.robots import RobotFile
from station.devices.aurora.tracker import TrackerMounting
from station.lab.config import HiddenConfig, TrackerConfig
from station.lab.plant import on_sensors

#: Centre of mass of the parts that hang on a base sensor, in the tube's axes [m].
SENSOR_CENTRE_OF_MASS_M = np.array([0.002, -0.001, 0.015])


class UnmodelledErrors:
    """The unknown errors of one lab, drawn once at its creation."""

    def __init__(self, robot: RobotFile, config: HiddenConfig, rng: np.random.Generator) -> None:
        description = robot.robot()
        q, joints = len(description.tubes), description.joints
        angle, offset, tilt, shift = (random_direction(rng) for _ in range(4))
        self._generator = TrackerMounting(
            rotation_from_vector(config.registration_rotation * angle), config.registration_translation * offset
        )
        self._base = Base(tuple((config.base_position * shift).tolist()), tuple((config.base_rotation * tilt).tolist()))
        self.coil = np.array(config.coil_offset)  #: (3,) position of the coil in the frame of the tip [m]
        self.misaligned = config.coil_misalignment > 0.0  #: whether the coil's axis differs from the tip's
        # The misalignment has a separate random stream, so that the other errors are the same with and without it.
        about = float(rng.spawn(1)[0].uniform(-math.pi, math.pi))
        turn = rotation_from_vector(config.coil_misalignment * np.array([math.cos(about), math.sin(about), 0.0]))
        self.coil_axis: Array = turn[:, 2].copy()  #: (3,) direction of the coil's axis in the frame of the tip
        self.late = config.tracker_latency  #: latency of the tracker in addition to the configured latency [s]
        random = rng.uniform(-1.0, 1.0, len(joints))
        turns = np.array([joint.motion == "rotation" for joint in joints])
        self._zero = random * np.where(turns, config.rotation_zero, config.translation_zero)
        # The outermost tube has no zero error, because its zero angle defines the x axis of the robot's frame.
        outermost = [k for k, joint in enumerate(joints) if joint.motion == "rotation" and joint.tube == q - 1]
        self._zero[outermost] = 0.0
        self._sign = np.array([-1.0 if joint.name in config.mirrored else 1.0 for joint in joints])
        middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
        self._shift = np.where(self._sign < 0.0, 2.0 * middle, 0.0) + self._zero
        self._changes_joints = bool(self._shift.any() or (self._sign < 0.0).any())
        count = len(description.sensor_names)
        self._mounting = [rotation_from_vector(config.sensor_mounting * random_direction(rng)).T for _ in range(count)]
        self._weight = config.sensor_weight
        self._tube_of = {joint.tube: k for k, joint in enumerate(joints) if joint.motion == "rotation"}
        #: Whether `felt` changes the wrenches.
        self.changes_wrenches = (
            config.sensor_mounting > 0.0 or config.sensor_weight > 0.0 or description.sensed != "tubes"
        )
        self._description = description
        self._rest = np.array([tube.rotation for tube in description.tubes])

    def robot(self, robot: Robot) -> Robot:
        """Return the robot with the pose error of its front plate."""
        if not any((*self._base.position, *self._base.rotation_vector)):
            return robot
        turned = Base(robot.base.position, self._base.rotation_vector)
        rotation = turned.rotation @ robot.base.rotation
        position = np.array(robot.base.position) + np.array(self._base.position)
        return replace(robot, base=Base(tuple(position.tolist()), _vector(rotation)))

    def joints(self, positions: Array) -> Array:
        """Return the true joint positions (n,) for the stages' counts `positions` (n,)."""
        return self._sign * positions + self._shift if self._changes_joints else positions

    def mount(self, mount: TrackerMounting) -> TrackerMounting:
        """Return the true pose of the field generator for the configured pose `mount`."""
        return self._generator.after(mount)

    def tracker(self, config: TrackerConfig) -> TrackerConfig:
        """Return the tracker's configuration with the unknown latency."""
        return config.model_copy(update={"latency": config.latency + self.late}) if self.late else config

    def felt(self, wrenches: Array, joints: Array, tubes_at: Array) -> Array:
        """Return the wrenches that the misaligned sensors measure (s, 6) when the tubes exert `wrenches` (q, 6).

        Args:
            wrenches: wrenches of the tubes, each in its tube's axes [N, N m].
            joints: true joint positions (n,) without play; they give the directions of the weights.
            tubes_at: true joint positions (n,) of the tubes, with the play of their drives.
        """
        loaded = np.empty_like(wrenches)
        for i, wrench in enumerate(wrenches):
            angle = joints[self._tube_of[i]] if i in self._tube_of else self._rest[i]
            weight = self._weight * np.array([math.cos(angle), -math.sin(angle), 0.0])  # gravity points along +x
            loaded[i, :3] = wrench[:3] + weight
            loaded[i, 3:] = wrench[3:] + np.cross(SENSOR_CENTRE_OF_MASS_M, weight)
        carried = on_sensors(self._description, tubes_at, loaded)
        return np.array([
            np.concatenate((turn @ wrench[:3], turn @ wrench[3:]))
            for turn, wrench in zip(self._mounting, carried, strict=True)
        ])  # fmt: skip


def random_direction(rng: np.random.Generator) -> Array:
    """Return a unit vector (3,) of random direction."""
    vector = rng.standard_normal(3)
    return vector / float(np.linalg.norm(vector))


def _vector(rotation: Array) -> tuple[float, float, float]:
    x, y, z = vector_from_rotation(rotation).tolist()
    return (x, y, z)
