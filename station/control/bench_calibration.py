"""Results of earlier calibrations of a bench, loaded for a run or a station."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from core.calibration.rigid_transform import rotation_from_vector, vector_from_rotation
from core.control.controller_settings import Controller
from core.control.deflection_force import CALIBRATED_TUBE_ERROR
from core.control.sensors import Corrections, Sensors
from core.control.tip_force import CALIBRATED_GAIN
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile, load_robot
from station.config.strict import ConfigError, Format, Name, NotNegative, Row, Strict, Vector, check, read_toml
from station.devices.aurora.tracker import TrackerMounting
from station.devices.cameras import CalibratedView

REGISTRATION_FILE, SENSORS_FILE, ROBOT_FILE = "registration.toml", "sensors.toml", "robot.toml"
#: Lenses and poses of cameras; `ctr-station cameras calibrate` writes it.
CAMERAS_FILE = "cameras.toml"


class RegistrationFile(Strict):
    """`registration.toml`: pose of the tracker's field generator in the robot's frame, and of the coil in the tip's."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot that the coil belongs to"""
    made: str
    """date and source of the calibration"""
    rotation_vector: Vector
    """rotation from the tracker's frame to the robot's: p_robot = R(rotation_vector) p_tracker + position [rad]"""
    position: Vector
    """origin of the tracker's frame in the robot's frame [m]"""
    coil: Vector = (0.0, 0.0, 0.0)
    """position of the coil in the frame of the innermost tube's tip [m]"""
    axis: Vector | None = None
    """axis of the coil in the frame of the innermost tube's tip, a unit vector; without this key the tip's axis (z)"""
    rms_error: NotNegative
    """RMS distance of the measured coil from the model's coil, over the poses of the calibration [m]"""
    rotation_interval: Vector
    """half width of the 95 % interval of the rotation about x, y, z [rad]"""
    position_interval: Vector
    """half width of the 95 % interval of the position along x, y, z [m]"""


Six = Annotated[tuple[float, float, float, float, float, float], Row]


class SensorFile(Strict):
    """Calibration of one base sensor."""

    mounting: Vector
    """rotation vector from the sensor's axes to the axes of its tube [rad]"""
    weight: float
    """weight that hangs on the sensor [N]; a fitted value may have any sign"""
    first_moment: Vector
    """weight times the position of the weight's centre of mass, in the tube's axes [N m]"""
    skew: Annotated[tuple[Six, Six, Six, Six, Six, Six], Row] | None = None
    """errors of gain and cross-talk: one row for each of Fx Fy Fz Tx Ty Tz, one column for each true component
    [N, N m by N, N m]"""


class SensorsFile(Strict):
    """`sensors.toml`: calibration of the base sensors. It has no offsets, because every run starts with a tare."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot whose tubes carry the sensors"""
    made: str
    """date and source of the calibration"""
    gravity: Vector
    """direction of gravity in the frame of the plate"""
    tubes: Mapping[str, SensorFile]
    """calibration of each tube's sensor by the tube's name; every tube is required"""


class ViewsFile(Strict):
    """`cameras.toml`: calibrated lenses and poses of cameras."""

    cameras: Mapping[Name, CalibratedView]
    """lens and pose of each camera by its name in the station file"""


@dataclass(frozen=True)
class BenchCalibration:
    """Calibrated parameters of a bench: tubes, pose of the tracker, and corrections of the sensors."""

    robot: RobotFile  #: robot with the calibrated tubes; the robot's file if the tubes were not calibrated
    registration: TrackerMounting | None
    corrections: Corrections
    folder: Path | None = None  #: folder that the calibration was read from
    fitted_tubes: bool = False  #: whether the tubes were calibrated
    #: Calibrated lenses and poses of cameras by name.
    views: Mapping[str, CalibratedView] = field(default_factory=dict[str, CalibratedView])

    @classmethod
    def load(cls, folder: Path, described: RobotFile) -> "BenchCalibration":
        """Load a calibration from a folder; every file is optional.

        Raises:
            ConfigError: the folder is missing or has no calibration file, or a file is invalid or for another robot.
        """
        if not folder.is_dir():
            raise ConfigError(f"{folder}: no such folder; make one with 'ctr-station calibrate'")
        frames, sensors, own = folder / REGISTRATION_FILE, folder / SENSORS_FILE, folder / ROBOT_FILE
        cameras = folder / CAMERAS_FILE
        if not any(path.is_file() for path in (frames, sensors, own, cameras)):
            raise ConfigError(
                f"{folder}: none of {REGISTRATION_FILE}, {SENSORS_FILE}, {ROBOT_FILE} and {CAMERAS_FILE} in it"
            )
        file = load_robot(str(own)) if own.is_file() else described
        _of_robot(file.name, described.name, own)
        robot = file.robot()
        registration, coil, axis = None, np.zeros(3), None
        if frames.is_file():
            known = check(RegistrationFile, read_toml(frames), str(frames))
            _of_robot(known.robot, robot.name, frames)
            registration = TrackerMounting(
                rotation_from_vector(np.array(known.rotation_vector)), np.array(known.position)
            )
            coil = np.array(known.coil)
            axis = None if known.axis is None else _axis(known.axis, frames)
        found = Sensors.ideal(len(robot.tubes))
        if sensors.is_file():
            found = _sensors(check(SensorsFile, read_toml(sensors), str(sensors)), robot, sensors)
        views = check(ViewsFile, read_toml(cameras), str(cameras)).cameras if cameras.is_file() else {}
        return cls(file, registration, Corrections(found, coil, axis), folder, own.is_file(), views)

    @property
    def mount(self) -> dict[str, list[float]] | None:
        """Pose of the tracker for a station file's `[devices.tracker.mount]`; None if it was not calibrated."""
        if self.registration is None:
            return None
        turn = vector_from_rotation(self.registration.rotation)
        return {"position": self.registration.position.tolist(), "rotation_vector": turn.tolist()}

    def applied(self, controller: Controller) -> Controller:
        """Return the controller with corrections of coil and sensors.

        Calibrated gains of the sensors and calibrated tubes get smaller assumed errors.
        """
        estimator = controller.estimator
        skew = self.corrections.sensors.skew
        if skew is not None and skew.any():
            errors = replace(estimator.load.errors, gain=CALIBRATED_GAIN)
            estimator = replace(estimator, load=replace(estimator.load, errors=errors))
        tube_error = CALIBRATED_TUBE_ERROR if self.fitted_tubes else controller.tube_error
        return replace(controller, corrections=self.corrections, estimator=estimator, tube_error=tube_error)


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
        np.array([rotation_from_vector(np.array(row.mounting)) for row in rows]),
        np.array([row.weight for row in rows]),
        np.array([row.first_moment for row in rows]),
        np.array(file.gravity),
        np.array([np.zeros((6, 6)) if row.skew is None else row.skew for row in rows]),
    )


def _of_robot(name: str, robot: str, path: Path) -> None:
    if name != robot:
        raise ConfigError(f"{path}: of robot '{name}', but the robot is '{robot}'; calibrate this one")
