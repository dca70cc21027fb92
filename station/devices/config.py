"""The table `[devices]` of a station file, and what the options of several drivers share."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from core.calibration.rigid_transform import RigidTransform, vector_from_rotation
from core.robot.robot import Array, Base
from station.config.controllers import Present
from station.config.strict import ConfigError, Strict, Vector
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, WrenchReading

#: pyserial's name of a port: /dev/ttyUSB0, COM3, socket://host:port.
Serial = Annotated[str, Field(min_length=1)]
TcpPort = Annotated[int, Field(ge=1, le=65535)]


def _names_a_driver(options: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(options.get("driver"), str):
        raise ValueError("'driver' is missing: the name of a driver, in quotes")
    return options


#: Table of one device: `driver` names the driver, the other keys are the driver's options.
Options = Annotated[Mapping[str, Any], AfterValidator(_names_a_driver)]


class BenchFile(Strict):
    """The devices of a bench."""

    stages: Options
    """`driver` and the driver's options"""
    tracker: Options | None = None
    """`driver` and the driver's options; without this table the bench has no tracker"""
    sensors: Options | None = None
    """`driver` and the driver's options; without this table the bench has no force sensors"""

    @property
    def can_measure_target(self) -> bool:
        """Whether the tracker may measure a target: true for an Aurora with a second coil and for custom drivers."""
        if self.tracker is None or self.tracker["driver"] == "stereo":
            return False
        return self.tracker["driver"] != "aurora" or bool(self.tracker.get("target"))

    @property
    def present(self) -> Present:
        """Which devices the bench has besides its stages."""
        return Present(self.tracker is not None, self.sensors is not None)


def _is_either(value: object) -> object:
    if value != "virtual" and not isinstance(value, Mapping | BenchFile):
        raise ValueError("expected 'virtual', or a table of stages, and of tracker and sensors if there are any")
    return value


#: Value of `devices` in a station file: "virtual" for the virtual lab, or the tables of a bench.
DevicesFile = Annotated[
    Annotated[Literal["virtual"], Tag("virtual")] | Annotated[BenchFile, Tag("bench")],
    Discriminator(lambda value: "virtual" if value == "virtual" else "bench"),
    BeforeValidator(_is_either),
]


class Mount(Strict):
    """Pose of a device's frame in another frame."""

    position: Vector = (0.0, 0.0, 0.0)
    """position of the device frame's origin [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """orientation of the device's frame: rotation axis times angle [rad]"""

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from the axes of the device's frame to those of the other frame."""
        return Base(self.position, self.rotation_vector).rotation

    def moved(self, by: RigidTransform) -> "Mount":
        """Return the pose after a rigid transform of the other frame."""
        whole = by.after(RigidTransform(self.rotation, np.array(self.position)))
        position, vector = whole.position.tolist(), vector_from_rotation(whole.rotation).tolist()
        return Mount(position=(*position,), rotation_vector=(*vector,))


Part = TypeVar("Part")


def in_order(parts: Mapping[str, Part], names: Sequence[str], key: str) -> list[Part]:
    """Return the parts, which are joints' or tubes' tables by name, in the robot's order `names`.

    Raises:
        ConfigError: a part is missing, or the robot has no part of that name.
    """
    for name in parts:
        if name not in names:
            raise ConfigError(f"{key}.{name}: the robot has no such part; it has {', '.join(names)}")
    for name in names:
        if name not in parts:
            raise ConfigError(f"{key}.{name} is missing")
    return [parts[name] for name in names]


def transport(mount: Mount) -> Array:
    """Return the matrix (6, 6) from wrenches in the sensor's frame to wrenches in the frame at the tube's proximal end.

    f' = R f and m' = R m + p x R f, with the position p and the rotation R of the mount.
    """
    x, y, z = mount.position
    rotation, shift = mount.rotation, np.eye(6)
    shift[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    rotated = np.zeros((6, 6))
    rotated[:3, :3] = rotated[3:, 3:] = rotation
    return shift @ rotated


def mounted(sensors: BaseSensors, mounts: Sequence[Mount]) -> BaseSensors:
    """Return sensors with their mounts applied, one per tube; without a mount return the sensors unchanged."""
    return sensors if all(mount == Mount() for mount in mounts) else MountedSensors(sensors, mounts)


class MountedSensors:
    """Sensors whose wrenches are transformed by their mounts."""

    def __init__(self, sensors: BaseSensors, mounts: Sequence[Mount]) -> None:
        self._sensors = sensors
        self._transports = np.array([transport(mount) for mount in mounts])

    @property
    def condition(self) -> Condition:
        """Connection state of the sensors."""
        return self._sensors.condition

    def connect(self, now: float) -> None:
        """Connect the sensors."""
        self._sensors.connect(now)

    def poll(self, now: float) -> WrenchReading:
        """Return the newest sample, in the frames at the tubes' proximal ends."""
        reading = self._sensors.poll(now)
        wrenches = np.einsum("kij,kj->ki", self._transports, reading.wrenches)
        return WrenchReading(reading.time, wrenches, reading.usable)

    def trouble(self, now: float) -> DeviceFault | None:
        """Return the most severe fault of the sensors, or None."""
        return self._sensors.trouble(now)

    def details(self) -> Mapping[str, Any]:
        """Return identity and counters of the sensors."""
        return self._sensors.details()

    def close(self) -> None:
        """Close the sensors."""
        self._sensors.close()
