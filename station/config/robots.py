"""Robot files: the TOML description of tubes, joints and the stages that move them."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, PrivateAttr

from core.control.reachability import check_pose
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.limits import ForceBound, ForceLimit, JointLimit, Limit, Limits, TubeOrder, Workspace
from core.robot.robot import MAX_LENGTH_M, Array, Base, Joint, Robot, Section, Tube
from core.robot.strength import force_bound
from station.config.strict import (
    ConfigError,
    Document,
    Format,
    Line,
    Name,
    Row,
    Strict,
    check,
    line_reference,
    parse_toml,
    preset,
    read_toml,
)

#: Locations of force sensors that measure the whole load. A sensor on one of several tubes measures its share of the
#: load, plus the unknown forces between the tubes.
WHOLE_LOAD = ("tubes", "robot")
#: Standard gravity [m/s^2].
STANDARD_GRAVITY = 9.80665

# Ranges of the numbers of a robot's file. They contain every robot that can be built; a number beyond them has a wrong
# unit, or too many digits for the arithmetic of the model.
#: Length of a section [m]; the tube itself is at most `MAX_LENGTH_M` long.
Length = Annotated[float, Field(gt=0.0, le=MAX_LENGTH_M)]
#: Curvature [1/m]; a tube with a smaller radius than 1 mm cannot be bent.
Curvature = Annotated[float, Field(ge=-1000.0, le=1000.0)]
#: Bending or torsional stiffness [N m^2]; a steel rod of 18 mm has 1000 N m^2.
Stiffness = Annotated[float, Field(gt=0.0, le=1000.0)]
#: Angle or position of a joint [rad or m]; 1000 rad are 160 turns.
JointPosition = Annotated[float, Field(ge=-1000.0, le=1000.0)]
#: Coordinate in the world [m]; a robot is in a room.
Coordinate = Annotated[float, Field(ge=-100.0, le=100.0)]
#: Component of a rotation vector [rad]; one turn reaches every orientation.
Rotation = Annotated[float, Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]
Coordinates = Annotated[tuple[Coordinate, Coordinate, Coordinate], Row]
RotationVector = Annotated[tuple[Rotation, Rotation, Rotation], Row]


class SectionFile(Strict):
    """One section of a tube, in order from the proximal end."""

    length: Length
    """length of the section, along the tube [m]"""
    curvature: Annotated[tuple[Curvature, Curvature], Row] = (0.0, 0.0)
    """curvature about x and y of the tube's frame [1/m]; an arc of radius r that bends towards -y is [1/r, 0]"""


class TubeFile(Strict):
    """One tube; innermost first in the file."""

    name: Name
    """name by which joints, labs, sensors and calibrations refer to the tube"""
    bending_stiffness: Stiffness
    """bending stiffness EI [N m^2]"""
    poisson_ratio: Annotated[float, Field(gt=-1.0, le=0.5)] = 0.30
    """Poisson's ratio, which gives GJ = EI / (1 + poisson_ratio)"""
    torsional_stiffness: Stiffness | None = None
    """torsional stiffness GJ of a tube for which poisson_ratio does not hold, such as a patterned tube [N m^2]"""
    rotation: JointPosition = 0.0
    """fixed angle of a tube without a rotation joint [rad]"""
    translation: Annotated[float, Field(ge=-MAX_LENGTH_M, le=0.0)] = 0.0
    """fixed proximal end of a tube without a translation joint, behind the plate [m]"""
    outer_diameter: Annotated[float, Field(gt=0.0, le=0.1)]
    """outer diameter of the tube [m]"""
    inner_diameter: Annotated[float, Field(ge=0.0, le=0.1)]
    """inner diameter of the tube, less than `outer_diameter` [m]"""
    density: Annotated[float, Field(ge=0.0, le=25e3)] = 0.0
    """density of the material, from which calibration computes the tube's weight; 0 neglects the weight [kg/m^3]"""
    max_strain: Annotated[float, Field(gt=0.0, le=1.0)] = 0.08
    """largest strain from which the material recovers its shape, about 0.08 for superelastic nitinol and 0.002 for
    steel; a larger strain causes a warning"""
    sections: Annotated[tuple[SectionFile, ...], Row]
    """sections of the tube, in order from the proximal to the distal end"""

    @property
    def weight(self) -> float:
        """Weight of the tube per length [N/m]."""
        return STANDARD_GRAVITY * self.density * 0.25 * math.pi * (self.outer_diameter**2 - self.inner_diameter**2)


class JointFile(Strict):
    """One stage and the tube it moves."""

    name: Name
    """name by which start poses, station files, recordings and the page refer to the joint"""
    tube: str
    """name of the tube that the stage moves"""
    motion: Literal["rotation", "translation"]
    """kind of the motion: `rotation` turns the tube about z, `translation` slides it along z"""
    lower: JointPosition
    """lower end of the travel, less than `upper` [rad or m]"""
    upper: JointPosition
    """upper end of the travel, greater than `lower` [rad or m]"""
    speed: Annotated[float, Field(gt=0.0, le=1000.0)]
    """speed limit of the stage [rad/s or m/s]"""
    acceleration: Annotated[float, Field(gt=0.0, le=1e6)]
    """deceleration that the stage can reach [rad/s^2 or m/s^2]"""
    microstep: Annotated[float, Field(gt=0.0, le=1.0)]
    """resolution of the stage [rad or m]"""


class BaseFile(Strict):
    """Pose of the front plate in the world frame."""

    position: Coordinates = (0.0, 0.0, 0.0)
    """position of the plate's origin [m]"""
    rotation_vector: RotationVector = (0.0, 0.0, 0.0)
    """orientation of the plate's axes: rotation axis times angle [rad]"""


class WorkspaceBoxFile(Strict):
    """Box in which the tip must stay."""

    lower: Coordinates
    """corner of the box with the smallest x, y, z [m]"""
    upper: Coordinates
    """corner of the box with the largest x, y, z, beyond `lower` [m]"""


class RobotFile(Strict):
    """A robot and its stages."""

    format: Format = 1
    """number of the file format"""
    name: Line
    """name of the robot in recordings, reports and calibrations"""
    source: str = ""
    """source of the numbers in this file"""
    base: BaseFile = BaseFile()
    """pose of the robot's front plate"""
    tubes: Annotated[tuple[TubeFile, ...], Row]
    """tubes of the robot, 1 to 8, the innermost first"""
    joints: tuple[JointFile, ...] = Field(min_length=1, strict=False)
    """stages of the robot, in the order of every list of joints"""
    working_pose: Mapping[str, JointPosition] | None = None
    """joint positions to move to after homing, where motions have room [rad or m]; without this key no move follows"""
    workspace: WorkspaceBoxFile | None = None
    """bounds of the tip, world frame; without this table only the joint limits bound the tip"""
    ends_in_order: bool = False
    """true: limits keep the end of every tube beyond the end of the tube around it; false: a tube may retract into the
    tubes around it. The tip is always the end of the innermost tube"""
    max_force: Annotated[float, Field(gt=0.0, le=1000.0)] | None = None
    """largest force on the tip, above which every motion ends in HOLD [N]; default: the force that tubes and base
    sensors can bear, 0.94 N for the preset `paper` (`core/robot/strength.py`)"""

    integrator: Literal["paper"] | None = None
    """paper: compute with the paper's second-order integrator and sub-links of 10 mm, as long as no tube bends by more
    than 0.05 rad in a sub-link; default: the fourth-order integrator, whose sub-links follow from the tubes"""

    _sensed: str = PrivateAttr("tubes")

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Name of each force sensor: that of the tube that it carries, or `robot` if it carries the whole robot."""
        return self.robot().sensor_names

    def sensed_at(self, at: str, key: str) -> "RobotFile":
        """Return the robot on a bench whose force sensors are at `at`; `key` is the TOML key, for messages.

        Raises:
            ConfigError: the robot has no sensors at `at`.
        """
        names = [tube.name for tube in self.tubes]
        if at not in (*WHOLE_LOAD, *(names if len(names) > 1 else ())) or (at == "robot" and at in names):
            raise ConfigError(
                f"{key} = '{at}': expected 'tubes' (a force sensor on each tube), 'robot' (one under the whole robot;"
                f" no tube may have this name), or the only one of several tubes with a sensor: {', '.join(names)}"
            )
        robot = self.model_copy()
        robot._sensed = at
        return robot

    def robot(self) -> Robot:
        """Return the description that the model uses."""
        index = {tube.name: i for i, tube in enumerate(self.tubes)}
        if len(index) < len(self.tubes):
            raise ConfigError(f"two of the tubes {', '.join(tube.name for tube in self.tubes)} have the same name")
        for joint in self.joints:
            if joint.tube not in index:
                raise ConfigError(
                    f"joint '{joint.name}' moves tube '{joint.tube}', which is not one of {', '.join(index)}"
                )
        return Robot(
            self.name,
            tuple(
                Tube(
                    tube.name,
                    tuple(Section(section.length, section.curvature) for section in tube.sections),
                    tube.bending_stiffness,
                    tube.poisson_ratio,
                    tube.outer_diameter,
                    tube.inner_diameter,
                    tube.torsional_stiffness,
                    tube.rotation,
                    tube.translation,
                    tube.weight,
                    tube.max_strain,
                )
                for tube in self.tubes
            ),
            tuple(Joint(joint.name, index[joint.tube], joint.motion) for joint in self.joints),
            Base(self.base.position, self.base.rotation_vector),
            self.integrator,
            self._sensed,
        )

    def limits(self) -> Limits:
        """Return the limits of joints, tubes, tip and force."""
        joints = tuple(
            JointLimit(
                joint.name,
                "rad" if joint.motion == "rotation" else "m",
                joint.lower,
                joint.upper,
                joint.speed,
                joint.acceleration,
            )
            for joint in self.joints
        )
        robot = self.robot()
        others: list[Limit] = []
        if (order := TubeOrder.of(robot, joints, self.ends_in_order)) is not None:
            others.append(order)
        if self.workspace is not None:
            others.append(Workspace(self.workspace.lower, self.workspace.upper))
        if self.max_force is not None:
            others.append(ForceLimit(self.max_force))
        overload = force_bound(robot, joints)
        if self.max_force is not None:
            overload = ForceBound(self.max_force, "max_force of the robot's file")
        return Limits(joints, others=tuple(others), overload=overload, tube_order=TubeOrder.of(robot, joints))

    def largest_force(self) -> ForceBound:
        """Return the largest force on the tip: `max_force`, or what tubes and sensors can bear."""
        bound = self.limits().overload
        return ForceBound(math.inf, "") if bound is None else bound


def load_robot(name: str) -> RobotFile:
    """Load a robot by preset name or from a file, and check it.

    Raises:
        ConfigError: the file is invalid; the message names file, key and value.
    """
    path = preset("robots", name)
    return _checked(read_toml(path), str(path))


def robot_of(text: str, source: str) -> RobotFile:
    """Return the robot that the text of a file describes; `source` is for messages.

    Raises:
        ConfigError: the text is invalid; the message names source, key and value.
    """
    return _checked(parse_toml(text, source), source)


def _checked(table: Document, source: str) -> RobotFile:
    file = check(RobotFile, table, source)
    try:
        check_robot(file)
    except CtrError as error:
        raise ConfigError(f"{source}: {error}{line_reference(table, str(error))}") from None
    return file


def check_robot(file: RobotFile) -> None:
    """Check that the keys of a robot's file are consistent: tubes, limits and working pose.

    Raises:
        CtrError: they are not; the message names the tube, joint or key.
    """
    robot, limits = file.robot(), file.limits()
    if file.working_pose is not None:
        check_pose(Statics(robot), limits, named_pose(file.working_pose, file, "working_pose"))


def named_pose(joints: Mapping[str, float], robot: RobotFile, key: str) -> Array:
    """Return joint positions (n,) from positions by name [rad or m]; `key` is their TOML key, for messages.

    Raises:
        ConfigError: joints are missing or unknown.
    """
    names = [joint.name for joint in robot.joints]
    for name in joints:
        if name not in names:
            raise ConfigError(f"{key}.{name}: robot '{robot.name}' has no such joint; it has {', '.join(names)}")
    if missing := [f"{key}.{name}" for name in names if name not in joints]:
        verb = "is" if len(missing) == 1 else "are"
        raise ConfigError(
            f"{', '.join(missing)} {verb} missing: {key} needs every joint of robot '{robot.name}' ({', '.join(names)})"
        )
    return np.array([joints[name] for name in names])


def start_pose(start: Mapping[str, float], robot: RobotFile) -> Array:
    """Return the joint positions (n,) of a start [rad or m].

    Raises:
        ConfigError: joints are missing or unknown.
    """
    return named_pose(start, robot, "start")
