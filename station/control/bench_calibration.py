"""Results of earlier calibrations of a bench, loaded for a run or a station."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from core.calibration.force import AXIS_RANGES
from core.calibration.rigid_transform import rotation_from_vector, vector_from_rotation
from core.control.controller_settings import Controller
from core.control.deflection_force import CALIBRATED_TUBE_ERROR
from core.control.sensors import Corrections, Sensors
from core.control.tip_force import CALIBRATED_GAIN
from core.control.tip_residual import TipResidual
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile, RotationVector, load_robot
from station.config.strict import ConfigError, Format, Name, Row, Strict, check, read_toml
from station.control.calibrated_robot import (
    CAMERAS_FILE,
    DESCRIBED_FILE,
    KINDS,
    LATENCY_FILE,
    REGISTRATION_FILE,
    RESIDUAL_FILE,
    ROBOT_FILE,
    SENSORS_FILE,
    calibrated_robot,
    check_made_for,
    check_unmeasured,
)
from station.control.residual_file import read_residual
from station.devices.aurora.tracker import TrackerMounting
from station.devices.cameras import CalibratedView, CameraFile, FrameSize
from station.devices.config import Position

# Plausible ranges of calibrated numbers. A number beyond its range comes from a failed fit or a damaged file.
#: Coordinate of the coil or ball in the tip's frame [m]; it is mounted on the innermost tube, near the tip.
CoilCoordinate = Annotated[float, Field(ge=-0.1, le=0.1)]
#: Component of a unit vector.
UnitComponent = Annotated[float, Field(ge=-1.0, le=1.0)]
#: RMS error of a registration [m]; the largest measured one is 1 mm, with tubes that bend differently from the model.
RmsError = Annotated[float, Field(ge=0.0, le=0.02)]
#: Latency of a tracker in addition to the configured one [s]; the procedure searches from -0.05 to 0.25 s.
AddedLatency = Annotated[float, Field(ge=-0.1, le=0.5)]
#: Half widths of 95 % intervals [rad, m]; a registration with larger intervals has determined nothing.
RotationInterval = Annotated[float, Field(ge=0.0, le=0.5)]
PositionInterval = Annotated[float, Field(ge=0.0, le=0.1)]
#: Component of a sensor's rotation relative to its tube [rad], ten standard deviations of its prior. The station file's
#: `mount` describes a sensor that is turned on purpose.
MountingAngle = Annotated[float, Field(ge=-0.5, le=0.5)]
#: Weight that hangs on a sensor [N] and its first moment [N m], ten standard deviations of their priors.
HangingWeight = Annotated[float, Field(ge=-5.0, le=5.0)]
FirstMoment = Annotated[float, Field(ge=-0.2, le=0.2)]
#: Largest error of gain or cross-talk, relative to the ranges of a sensor's axes: ten times the manufacturers' values.
MAX_GAIN_ERROR = 0.1
_RATIO = AXIS_RANGES[0] / AXIS_RANGES[3]  # range of a force axis divided by that of a moment axis [1/m]
Gain = Annotated[float, Field(ge=-MAX_GAIN_ERROR, le=MAX_GAIN_ERROR)]
#: Cross-talk from a moment to a force [N by N m], and from a force to a moment [N m by N].
ForceByMoment = Annotated[float, Field(ge=-MAX_GAIN_ERROR * _RATIO, le=MAX_GAIN_ERROR * _RATIO)]
MomentByForce = Annotated[float, Field(ge=-MAX_GAIN_ERROR / _RATIO, le=MAX_GAIN_ERROR / _RATIO)]
#: Smallest factor by which the correction of gains may scale a wrench along its direction, with each axis in units of
#: its range. A smaller factor would hide wrenches in a direction, and a negative one would reverse them.
MIN_KEPT_PART = 0.6
#: Largest ratio of the gains of two directions after the correction.
MAX_GAIN_RATIO = 2.0
#: Largest difference of the length of a unit vector from 1; files have six digits or more.
UNIT_TOLERANCE = 1e-3
#: Largest angle between a calibrated direction of gravity and the world's x axis, which points down [rad].
MAX_TILT_RAD = 0.1


def _of_unit_length(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if abs(math.hypot(*vector) - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"a unit vector needs the length 1 +- {UNIT_TOLERANCE:g}, not {math.hypot(*vector):.6g}")
    return vector


CoilPosition = Annotated[tuple[CoilCoordinate, CoilCoordinate, CoilCoordinate], Row]
UnitVector = Annotated[tuple[UnitComponent, UnitComponent, UnitComponent], Row, AfterValidator(_of_unit_length)]


class RegistrationFile(Strict):
    """`registration.toml`: pose of the tracker's field generator in the robot's frame, and of the coil in the tip's."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot that the coil belongs to"""
    made: str
    """date and source of the calibration"""
    rotation_vector: RotationVector
    """rotation from the tracker's frame to the robot's: p_robot = R(rotation_vector) p_tracker + position [rad]"""
    position: Position
    """origin of the tracker's frame in the robot's frame [m]"""
    coil: CoilPosition = (0.0, 0.0, 0.0)
    """position of the coil in the frame of the innermost tube's tip [m]"""
    axis: UnitVector | None = None
    """axis of the coil in the frame of the innermost tube's tip, a unit vector; without this key the tip's axis (z)"""
    rms_error: RmsError
    """RMS distance of the measured coil from the model's coil, over the poses of the calibration [m]"""
    rotation_interval: Annotated[tuple[RotationInterval, RotationInterval, RotationInterval], Row]
    """half width of the 95 % interval of the rotation about x, y, z [rad]"""
    position_interval: Annotated[tuple[PositionInterval, PositionInterval, PositionInterval], Row]
    """half width of the 95 % interval of the position along x, y, z [m]"""


class LatencyFile(Strict):
    """`latency.toml`: latency of the tracker."""

    format: Format = 1
    """format of this file"""
    made: str
    """date and source of the calibration"""
    added: AddedLatency
    """latency in addition to the key `latency` of `[devices.tracker]`, or to the driver's default [s]"""


ForceRow = Annotated[tuple[Gain, Gain, Gain, ForceByMoment, ForceByMoment, ForceByMoment], Row]
MomentRow = Annotated[tuple[MomentByForce, MomentByForce, MomentByForce, Gain, Gain, Gain], Row]
Skew = tuple[ForceRow, ForceRow, ForceRow, MomentRow, MomentRow, MomentRow]


def _keeps_wrenches(skew: Skew) -> Skew:
    """Return `skew` if the correction I - skew of the readings neither hides nor reverses a wrench.

    Raises:
        ValueError: the correction hides or reverses a wrench.
    """
    ranges = np.array(AXIS_RANGES)
    gains = np.eye(6) - np.array(skew) * ranges / ranges[:, None]
    kept, ratio = float(np.linalg.eigvalsh(0.5 * (gains + gains.T))[0]), float(np.linalg.cond(gains))
    if kept < MIN_KEPT_PART or ratio > MAX_GAIN_RATIO:
        raise ValueError(
            f"the correction leaves {kept:.3g} of a wrench in its weakest direction, and its gains differ by a"
            f" factor of {ratio:.3g}; expected at least {MIN_KEPT_PART:g}, and a factor of at most {MAX_GAIN_RATIO:g}"
        )
    return skew


class SensorFile(Strict):
    """Calibration of one base sensor."""

    mounting: Annotated[tuple[MountingAngle, MountingAngle, MountingAngle], Row]
    """rotation vector from the sensor's axes to the axes of its tube [rad]"""
    weight: HangingWeight
    """weight that hangs on the sensor [N]; a fitted value may have any sign"""
    first_moment: Annotated[tuple[FirstMoment, FirstMoment, FirstMoment], Row]
    """weight times the position of the weight's centre of mass, in the tube's axes [N m]"""
    skew: Annotated[Skew, Row, AfterValidator(_keeps_wrenches)] | None = None
    """errors of gain and cross-talk: one row for each of Fx Fy Fz Tx Ty Tz, one column for each true component
    [N, N m by N, N m]; at most 0.1 of the ranges of the axes, 18 N and 0.25 N m"""


class WeightFile(Strict):
    """Weight that moves with one tube and hangs on the sensor under the whole robot."""

    weight: HangingWeight
    """weight [N]; a fitted value may have any sign"""
    first_moment: Annotated[tuple[FirstMoment, FirstMoment, FirstMoment], Row]
    """weight times the position of its centre of mass, in the tube's axes [N m]"""


class WholeSensorFile(Strict):
    """Calibration of the sensor under the whole robot."""

    mounting: Annotated[tuple[MountingAngle, MountingAngle, MountingAngle], Row]
    """rotation vector from the sensor's axes to the axes of the plate [rad]"""
    skew: Annotated[Skew, Row, AfterValidator(_keeps_wrenches)] | None = None
    """errors of gain and cross-talk, as for the sensor of a tube"""
    weights: Mapping[str, WeightFile]
    """weights by the tube's name; every tube is required"""


class SensorsFile(Strict):
    """`sensors.toml`: calibration of the base sensors. It has no offsets, because every run starts with a tare."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot whose tubes carry the sensors"""
    made: str
    """date and source of the calibration"""
    gravity: UnitVector
    """direction of gravity in the frame of the plate, a unit vector: the world's x axis within 0.1 rad"""
    tubes: Mapping[str, SensorFile] = {}
    """calibration of each tube's sensor by the tube's name; every tube is required"""
    robot_sensor: WholeSensorFile | None = None
    """calibration of the sensor under the whole robot, instead of `tubes`"""


class BoardFile(Strict):
    """Board of which the pictures were taken."""

    square: Annotated[float, Field(ge=0.005, le=0.2)]
    """side of a square [m]"""


class ViewFile(CalibratedView):
    """Lens and pose of one camera, and the camera that they belong to."""

    device: Annotated[str, Field(min_length=1, max_length=200)]
    """the camera's `device` in the station file, or `simulated`"""
    width: FrameSize
    """columns of the calibrated frames"""
    height: FrameSize
    """rows of the calibrated frames"""

    @model_validator(mode="after")
    def _lens_of_these_frames(self) -> Self:
        for key, value, lower, upper in (
            *(("focal", focal, 0.2 * self.width, 20.0 * self.width) for focal in self.lens.focal),
            ("centre", self.lens.centre[0], 0.0, self.width),
            ("centre", self.lens.centre[1], 0.0, self.height),
        ):
            if not lower <= value <= upper:
                raise ValueError(
                    f"lens.{key} = {value:g} pixels is outside {lower:g} ... {upper:g} pixels for frames of"
                    f" {self.width} x {self.height}"
                )
        return self


class ViewsFile(Strict):
    """`cameras.toml`: calibrated lenses and poses of cameras."""

    format: Format = 1
    """format of this file"""
    robot: str
    """name of the robot in whose world frame the poses are given"""
    made: str
    """date and source of the calibration"""
    board: BoardFile
    """board of which the pictures were taken"""
    cameras: Mapping[Name, ViewFile]
    """lens and pose of each camera by its name in the station file"""


@dataclass(frozen=True)
class BenchCalibration:
    """Calibrated parameters of a bench: tubes, pose of the tracker, and corrections of the sensors."""

    robot: RobotFile  #: robot with the calibrated tubes, or with the described tubes if they were not calibrated
    registration: TrackerMounting | None
    corrections: Corrections
    folder: Path | None = None  #: folder that the calibration was read from
    fitted_tubes: bool = False  #: whether the tubes were calibrated
    #: Calibrated lenses and poses of cameras by name.
    views: Mapping[str, CalibratedView] = field(default_factory=dict[str, CalibratedView])
    warnings: tuple[str, ...] = ()  #: warnings for the operator about changes since the calibration
    residual: TipResidual | None = None  #: learned residual of the model
    latency: float = 0.0  #: latency of the tracker in addition to the configured one [s]

    @classmethod
    def load(
        cls, folder: Path, described: RobotFile, fitted: Mapping[str, CameraFile] | None = None
    ) -> "BenchCalibration":
        """Load a calibration from a folder; every file is optional.

        Args:
            folder: folder of the calibration.
            described: robot's file; all that was not calibrated comes from it.
            fitted: cameras of the station or lab by name; None: they are not checked.

        Raises:
            ConfigError: the folder is missing or has no calibration file, or a file is invalid or for another robot,
                for other tubes of the robot or for another camera.
        """
        if not folder.is_dir():
            raise ConfigError(f"{folder}: no such folder; create one with 'ctr-station calibrate'")
        frames, sensors, own = folder / REGISTRATION_FILE, folder / SENSORS_FILE, folder / ROBOT_FILE
        cameras, learned = folder / CAMERAS_FILE, folder / RESIDUAL_FILE
        files = tuple(name for name in KINDS if (folder / name).is_file())
        if not files:
            raise ConfigError(f"{folder}: it contains none of {', '.join(list(KINDS)[:-1])} and {CAMERAS_FILE}")
        file, warnings = described, _changes_since(folder, files, described)
        if own.is_file():
            calibrated = load_robot(str(own))
            _of_robot(calibrated.name, described.name, own)
            warnings += check_unmeasured(own, calibrated, described)
            file = calibrated_robot(described, calibrated, own)
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
        found = Sensors.ideal(robot)
        if sensors.is_file():
            found = _sensors(check(SensorsFile, read_toml(sensors), str(sensors)), robot, sensors)
        views: Mapping[str, ViewFile] = {}
        if cameras.is_file():
            taken = check(ViewsFile, read_toml(cameras), str(cameras))
            _of_robot(taken.robot, robot.name, cameras)
            views = taken.cameras
            warnings += () if fitted is None else _of_cameras(views, fitted, cameras)
        late = folder / LATENCY_FILE
        return cls(
            file, registration, Corrections(found, coil, axis), folder, own.is_file(), views,
            tuple(dict.fromkeys(warnings)),
            read_residual(learned, robot) if learned.is_file() else None,
            check(LatencyFile, read_toml(late), str(late)).added if late.is_file() else 0.0,
        )  # fmt: skip

    @property
    def mount(self) -> dict[str, list[float]] | None:
        """Pose of the tracker for a station file's `[devices.tracker.mount]`; None if it was not calibrated."""
        if self.registration is None:
            return None
        turn = vector_from_rotation(self.registration.rotation)
        return {"position": self.registration.position.tolist(), "rotation_vector": turn.tolist()}

    def applied(self, controller: Controller) -> Controller:
        """Return the controller with corrections of coil and sensors, and with the learned residual.

        Calibrated gains of the sensors and calibrated tubes get smaller assumed errors.
        """
        # Without a tracker nothing would show that the residual is wrong.
        estimator = replace(controller.estimator, residual=self.residual if controller.tracked else None)
        skew = self.corrections.sensors.skew
        if skew is not None and skew.any():
            errors = replace(estimator.load.errors, gain=CALIBRATED_GAIN)
            estimator = replace(estimator, load=replace(estimator.load, errors=errors))
        tube_error = CALIBRATED_TUBE_ERROR if self.fitted_tubes else controller.tube_error
        corrections = self.corrections
        if not controller.senses:  # no readings are used, and a hanging weight would look like a load
            corrections = replace(corrections, sensors=Sensors.ideal(controller.statics.robot))
        return replace(controller, corrections=corrections, estimator=estimator, tube_error=tube_error)


def _axis(axis: tuple[float, float, float], path: Path) -> Array:
    if axis[2] <= 0.0:
        raise ConfigError(f"{path}: axis {list(axis)} must be less than 90 deg from the tip's, which is [0, 0, 1]")
    return np.array(axis) / math.hypot(*axis)


def _sensors(file: SensorsFile, robot: Robot, path: Path) -> Sensors:
    _of_robot(file.robot, robot.name, path)
    whole, tubes = file.robot_sensor, file.tubes if file.robot_sensor is None else file.robot_sensor.weights
    if (whole is not None) != (robot.sensed == "robot"):
        made, has = ("tubes", "robot") if whole is None else ("robot", robot.sensed)
        raise ConfigError(
            f"{path}: made with force sensors at '{made}', but the bench has them at '{has}'; calibrate again, or"
            " correct the key 'at' of [devices.sensors] or of the lab's [sensors]"
        )
    for tube in robot.tubes:
        if tube.name not in tubes:
            raise ConfigError(f"{path}: tubes.{tube.name} is missing; robot '{robot.name}' has such a tube")
    down = robot.base.rotation.T @ np.array([1.0, 0.0, 0.0])
    tilt = math.acos(min(1.0, max(-1.0, float(down @ np.array(file.gravity)) / math.hypot(*file.gravity))))
    if tilt > MAX_TILT_RAD:
        raise ConfigError(
            f"{path}: gravity = {list(file.gravity)} is {math.degrees(tilt):.3g} deg from the world's x axis, which"
            f" points down; at most {math.degrees(MAX_TILT_RAD):.2g} deg: correct base.rotation_vector of the robot's"
            " file, or calibrate again"
        )
    rows = [whole] if whole is not None else [file.tubes[tube.name] for tube in robot.tubes]
    weights = [tubes[tube.name] for tube in robot.tubes]
    return Sensors(
        np.array([rotation_from_vector(np.array(row.mounting)) for row in rows]),
        np.array([row.weight for row in weights]),
        np.array([row.first_moment for row in weights]),
        np.array(file.gravity),
        np.array([np.zeros((6, 6)) if row.skew is None else row.skew for row in rows]),
    )


def _changes_since(folder: Path, files: tuple[str, ...], described: RobotFile) -> tuple[str, ...]:
    """Return warnings about changes of the robot's file since the calibration.

    Raises:
        ConfigError: a change makes the calibration wrong.
    """
    path = folder / DESCRIBED_FILE
    if path.is_file():
        made_for = load_robot(str(path))
        _of_robot(made_for.name, described.name, path)
        return check_made_for(folder, files, made_for, described)
    if not any(_of_tubes(name) for name in files):
        return ()
    return (
        f"calibration {folder} has no {DESCRIBED_FILE}, because an earlier version wrote it: changes of the tubes since"
        " the calibration are not detected; calibrate again if a tube has changed",
    )


def _of_tubes(name: str) -> bool:
    """Return whether a file of a calibration is valid for the described tubes only."""
    return "tubes.*" in KINDS[name].made_for


def _of_cameras(views: Mapping[str, ViewFile], fitted: Mapping[str, CameraFile], path: Path) -> tuple[str, ...]:
    """Return warnings about calibrated cameras that are not fitted.

    Raises:
        ConfigError: a fitted camera is not the calibrated one.
    """
    warnings: list[str] = []
    for name, view in views.items():
        if name not in fitted:
            warnings.append(f"{path}: camera '{name}' is calibrated, but the station has no camera of this name")
            continue
        for key in ("device", "width", "height"):
            was, is_ = getattr(view, key), getattr(fitted[name], key)
            if was != is_:
                raise ConfigError(
                    f"{path}: cameras.{name} was calibrated with {key} = {was!r}, but the camera has {is_!r};"
                    " calibrate the cameras again"
                )
    return tuple(warnings)


def _of_robot(name: str, robot: str, path: Path) -> None:
    if name != robot:
        raise ConfigError(f"{path}: made for robot '{name}', but the robot is '{robot}'; calibrate this robot")
