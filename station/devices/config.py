"""The table `[devices]` of a station file, and the types and checks that several drivers use for their options."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from core.calibration.rigid_transform import RigidTransform, vector_from_rotation
from core.robot.robot import Array, Base
from station.config.controllers import Present
from station.config.robots import WHOLE_LOAD, RobotFile, RotationVector
from station.config.strict import ConfigError, Row, Strict, has_control_characters
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, WrenchReading

#: pyserial's name of a port: /dev/ttyUSB0, COM3, socket://host:port.
Serial = Annotated[str, Field(min_length=1)]
TcpPort = Annotated[int, Field(ge=1, le=65535)]


def _names_a_driver(options: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(options.get("driver"), str):
        raise ValueError("'driver' is missing; give the name of a driver in quotes")
    if has_control_characters(options["driver"]):
        raise ValueError("'driver' has a line break or another control character; give the name of a driver")
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
    """`driver`, the driver's options, and `at`: `"tubes"` (default), a force sensor on each tube; `"robot"`, one under
    the whole robot; or the name of the only tube with a sensor. Without this table the bench has no force sensors"""

    @property
    def can_measure_target(self) -> bool:
        """Whether the tracker may measure a target: true for an Aurora with a second coil and for custom drivers."""
        if self.tracker is None or self.tracker["driver"] == "stereo":
            return False
        keys = ("target", "target_port", "target_channel")
        return self.tracker["driver"] != "aurora" or any(self.tracker.get(key) not in (None, "") for key in keys)

    @property
    def sensors_at(self) -> str:
        """Where the force sensors are: `"tubes"`, `"robot"` or the name of a tube, see `RobotFile.sensed_at`."""
        return "tubes" if self.sensors is None else str(self.sensors.get("at", "tubes"))

    @property
    def present(self) -> Present:
        """Whether the bench measures the tip, and whether it measures the whole load."""
        return Present(self.tracker is not None, self.sensors is not None and self.sensors_at in WHOLE_LOAD)


def _is_either(value: object) -> object:
    if value != "virtual" and not isinstance(value, Mapping | BenchFile):
        raise ValueError("expected 'virtual', or a table of stages with optional tables of tracker and sensors")
    return value


#: Value of `devices` in a station file: "virtual" for the virtual lab, or the tables of a bench.
DevicesFile = Annotated[
    Annotated[Literal["virtual"], Tag("virtual")] | Annotated[BenchFile, Tag("bench")],
    Discriminator(lambda value: "virtual" if value == "virtual" else "bench"),
    BeforeValidator(_is_either),
]


#: Coordinate of a device [m]. The bounds are wide: trackers and cameras are at most a few metres from the robot.
Distance = Annotated[float, Field(ge=-10.0, le=10.0)]
Position = Annotated[tuple[Distance, Distance, Distance], Row]


#: End of an error message: what to do if the bench has no force sensors.
WITHOUT_SENSORS = "; or leave [devices.sensors] out: the force is then estimated from the deflection of the tip"


class Mount(Strict):
    """Pose of a device's frame in another frame."""

    position: Position = (0.0, 0.0, 0.0)
    """position of the device frame's origin [m]"""
    rotation_vector: RotationVector = (0.0, 0.0, 0.0)
    """orientation of the device's frame: rotation axis times angle [rad]"""

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from the axes of the device's frame to those of the other frame."""
        return Base(self.position, self.rotation_vector).rotation

    def moved(self, by: RigidTransform) -> "Mount":
        """Return the pose that results if the transform `by`, given in the other frame, is applied to this pose."""
        whole = by.after(RigidTransform(self.rotation, np.array(self.position)))
        position, vector = whole.position.tolist(), vector_from_rotation(whole.rotation).tolist()
        return Mount(position=(*position,), rotation_vector=(*vector,))


Part = TypeVar("Part")


def in_order(parts: Mapping[str, Part], names: Sequence[str], key: str, otherwise: str = "") -> list[Part]:
    """Return `parts`, the tables of joints or tubes by name, as a list in the order of the robot's `names`.

    `otherwise`: end of the message about a missing part, such as an alternative.

    Raises:
        ConfigError: a part is missing, or the robot has no part of that name.
    """
    for name in parts:
        if name not in names:
            raise ConfigError(f"{key}.{name}: the robot has no such part; it has {', '.join(names)}")
    for name in names:
        if name not in parts:
            raise ConfigError(f"{key}.{name} is missing: all of {', '.join(names)} are needed{otherwise}")
    return [parts[name] for name in names]


def sensor_tables(
    tubes: Mapping[str, Part], whole: Part | None, robot: RobotFile, key: str = "devices.sensors"
) -> tuple[list[Part], list[str]]:
    """Return the tables of the force sensors in the robot's order, and the keys of these tables.

    Raises:
        ConfigError: the tables do not fit the key `at` of the bench.
    """
    names = list(robot.sensor_names)
    if names == ["robot"]:
        if tubes or whole is None:
            wrong = f"{key}.tubes.{next(iter(tubes))}" if tubes else f"{key}.robot is missing"
            raise ConfigError(
                f"{wrong}: with at = 'robot' one sensor carries the whole robot: describe it in [{key}.robot], or"
                " remove the key 'at' for a sensor on each tube"
            )
        return [whole], [f"{key}.robot"]
    if whole is not None:
        raise ConfigError(f"{key}.robot: a sensor under the whole robot needs at = 'robot' in [{key}], without tubes")
    one = f", or set at = 'robot' or the tube's name for a single sensor{WITHOUT_SENSORS}"
    return in_order(tubes, names, f"{key}.tubes", one), [f"{key}.tubes.{name}" for name in names]


def twins(values: Mapping[str, object]) -> tuple[str, str] | None:
    """Return the names of the first two parts with equal values, else None; a value None or "" is unknown."""
    taken: dict[object, str] = {}
    for name, value in values.items():
        if value not in (None, "") and (other := taken.setdefault(value, name)) != name:
            return other, name
    return None


def transport(mount: Mount) -> Array:
    """Return the matrix (6, 6) that converts a wrench from the sensor's frame to the frame at the tube's proximal end.

    f' = R f and m' = R m + p x R f, with the position p and the rotation R of the mount.
    """
    x, y, z = mount.position
    rotation, shift = mount.rotation, np.eye(6)
    shift[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    rotated = np.zeros((6, 6))
    rotated[:3, :3] = rotated[3:, 3:] = rotation
    return shift @ rotated


def mounted(sensors: BaseSensors, mounts: Sequence[Mount]) -> BaseSensors:
    """Return the sensors with their wrenches transformed by `mounts`; unchanged if every mount is the default."""
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
