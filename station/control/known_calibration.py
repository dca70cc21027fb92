"""What earlier calibrations have found of a bench, read back for a run or a station."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from core.calibration.rigid import rotation_of, vector_of
from core.control.corrections import Corrections
from core.control.sensors import Sensors
from core.control.step import Controller
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile, load_robot
from station.config.strict import ConfigError, Format, NotNegative, Row, Strict, Vector, check, read_toml
from station.devices.aurora.tracker import Registration

REGISTRATION, SENSORS, ROBOT = "registration.toml", "sensors.toml", "robot.toml"


class RegistrationFile(Strict):
    """`registration.toml`: where the tracker's field generator stands in the robot's frame, the coil in the tip's."""

    format: Format = 1
    """of this file"""
    robot: str
    """its name: the coil belongs to it"""
    made: str
    """when and from what"""
    rotation_vector: Vector
    """p_robot = R(rotation_vector) p_tracker + position [rad]"""
    position: Vector
    """the other part of that motion [m]"""
    coil: Vector = (0.0, 0.0, 0.0)
    """of the coil in the frame of the innermost tube's tip [m]"""
    axis: Vector | None = None
    """of the coil in that frame, unit vector; none: it points where the tip does"""
    rms_error: NotNegative
    """between coil and model at the poses it was made from [m]"""
    rotation_interval: Vector
    """half of 95 %, about x, y, z [rad]"""
    position_interval: Vector
    """half of 95 %, along x, y, z [m]"""


Six = Annotated[tuple[float, float, float, float, float, float], Row]


class SensorFile(Strict):
    """One base sensor."""

    mounting: Vector
    """rotation vector from the sensor's axes to its tube's [rad]"""
    weight: float
    """of what hangs on it, any number [N]"""
    first_moment: Vector
    """weight times its place in the tube's axes [N m]"""
    skew: Annotated[tuple[Six, Six, Six, Six, Six, Six], Row] | None = None
    """what a reading has too much of Fx Fy Fz Tx Ty Tz, a row each, for each of its parts [N, N m by N, N m]"""


class SensorsFile(Strict):
    """`sensors.toml`: the base sensors. Their offsets are not here: they are tared before every run."""

    format: Format = 1
    """of this file"""
    robot: str
    """its name: the sensors are at its tubes"""
    made: str
    """when and from what"""
    gravity: Vector
    """direction, plate's frame"""
    tubes: Mapping[str, SensorFile]
    """by tube name, all of them"""


@dataclass(frozen=True)
class Calibration:
    """What is known of a bench from earlier calibrations."""

    robot: RobotFile  #: tubes as they were found; as described where they were not calibrated
    registration: Registration | None
    corrections: Corrections
    folder: Path | None = None  #: where it was read from

    @classmethod
    def load(cls, folder: Path, described: RobotFile) -> "Calibration":
        """From a folder; a file that is not there says nothing.

        Raises:
            ConfigError: no such folder, none of the files in it, or one of them is wrong or of another robot.
        """
        if not folder.is_dir():
            raise ConfigError(f"{folder}: no such folder; make one with 'ctr-station calibrate'")
        frames, sensors, own = folder / REGISTRATION, folder / SENSORS, folder / ROBOT
        if not any(path.is_file() for path in (frames, sensors, own)):
            raise ConfigError(f"{folder}: none of {REGISTRATION}, {SENSORS} and {ROBOT} in it")
        file = load_robot(str(own)) if own.is_file() else described
        _of_robot(file.name, described.name, own)
        robot = file.robot()
        registration, coil, axis = None, np.zeros(3), None
        if frames.is_file():
            known = check(RegistrationFile, read_toml(frames), str(frames))
            _of_robot(known.robot, robot.name, frames)
            registration = Registration(rotation_of(np.array(known.rotation_vector)), np.array(known.position))
            coil = np.array(known.coil)
            axis = None if known.axis is None else _axis(known.axis, frames)
        found = Sensors.ideal(len(robot.tubes))
        if sensors.is_file():
            found = _sensors(check(SensorsFile, read_toml(sensors), str(sensors)), robot, sensors)
        return cls(file, registration, Corrections(found, coil, axis), folder)

    @property
    def mount(self) -> dict[str, list[float]] | None:
        """Where the tracker stands as a station file's `[devices.tracker.mount]`; None when that was not found."""
        if self.registration is None:
            return None
        turn = vector_of(self.registration.rotation)
        return {"position": self.registration.position.tolist(), "rotation_vector": turn.tolist()}

    def applied(self, controller: Controller) -> Controller:
        """The controller that takes coil and sensors into account."""
        return replace(controller, corrections=self.corrections)


def _axis(axis: tuple[float, float, float], path: Path) -> Array:
    length = math.hypot(*axis)
    if abs(length - 1.0) > 1e-3 or axis[2] <= 0.0:
        raise ConfigError(
            f"{path}: axis {list(axis)} must be of length 1 and less than 90 deg from the tip's, which is [0, 0, 1]"
        )
    return np.array(axis) / length


def _sensors(file: SensorsFile, robot: Robot, path: Path) -> Sensors:
    _of_robot(file.robot, robot.name, path)
    for tube in robot.tubes:
        if tube.name not in file.tubes:
            raise ConfigError(f"{path}: tubes.{tube.name} is missing; robot '{robot.name}' has such a tube")
    rows = [file.tubes[tube.name] for tube in robot.tubes]
    return Sensors(
        np.array([rotation_of(np.array(row.mounting)) for row in rows]),
        np.array([row.weight for row in rows]),
        np.array([row.first_moment for row in rows]),
        np.array(file.gravity),
        np.array([np.zeros((6, 6)) if row.skew is None else row.skew for row in rows]),
    )


def _of_robot(name: str, robot: str, path: Path) -> None:
    if name != robot:
        raise ConfigError(f"{path}: of robot '{name}', but the robot is '{robot}'; calibrate this one")
