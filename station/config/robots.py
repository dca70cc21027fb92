"""Robot files: the TOML description of tubes, joints and the stages that move them."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from core.control.reachability import check_pose
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.limits import ForceBound, ForceLimit, JointLimit, Limit, Limits, TubeOrder, Workspace
from core.robot.robot import Array, Base, Joint, Robot, Section, Tube
from core.robot.strength import force_bound
from station.config.strict import (
    ConfigError,
    Document,
    Format,
    Name,
    NotNegative,
    Positive,
    Row,
    Strict,
    Vector,
    check,
    line_reference,
    parse_toml,
    preset,
    read_toml,
)

#: Standard gravity [m/s^2].
STANDARD_GRAVITY = 9.80665


class SectionFile(Strict):
    """One section of a tube, in order from the proximal end."""

    length: Positive
    """length of the section, along the tube [m]"""
    curvature: Annotated[tuple[float, float], Row] = (0.0, 0.0)
    """curvature about x and y of the tube's frame [1/m]; an arc of radius r that bends towards -y is [1/r, 0]"""


class TubeFile(Strict):
    """One tube; innermost first in the file."""

    name: Name
    """name by which joints, labs, sensors and calibrations refer to the tube"""
    bending_stiffness: float
    """bending stiffness EI, greater than 0 [N m^2]"""
    poisson_ratio: float = 0.30
    """Poisson's ratio, which gives GJ = EI / (1 + poisson_ratio), -1 ... 0.5"""
    torsional_stiffness: float | None = None
    """torsional stiffness GJ of a tube for which poisson_ratio does not hold, such as a patterned tube, greater than 0
    [N m^2]"""
    rotation: float = 0.0
    """fixed angle of a tube without a rotation joint, any angle [rad]"""
    translation: float = 0.0
    """fixed proximal end of a tube without a translation joint, behind the plate: not positive [m]"""
    outer_diameter: float
    """outer diameter of the tube, greater than 0 [m]"""
    inner_diameter: float
    """inner diameter of the tube, 0 ... outer_diameter [m]"""
    density: NotNegative = 0.0
    """density of the material, from which calibration computes the tube's weight; 0 neglects the weight [kg/m^3]"""
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
    lower: float
    """lower end of the travel, less than `upper` [rad or m]"""
    upper: float
    """upper end of the travel, greater than `lower` [rad or m]"""
    speed: float
    """speed limit of the stage, greater than 0 [rad/s or m/s]"""
    acceleration: float
    """deceleration that the stage can reach, greater than 0 [rad/s^2 or m/s^2]"""
    microstep: Positive
    """resolution of the stage [rad or m]"""


Three = Annotated[tuple[float, float, float], Row]


class BaseFile(Strict):
    """Pose of the front plate in the world frame."""

    position: Three = (0.0, 0.0, 0.0)
    """position of the plate's origin, any value [m]"""
    rotation_vector: Three = (0.0, 0.0, 0.0)
    """orientation of the plate's axes: rotation axis times angle [rad]"""


class WorkspaceBoxFile(Strict):
    """Box in which the tip must stay."""

    lower: Vector
    """corner of the box with the smallest x, y, z [m]"""
    upper: Vector
    """corner of the box with the largest x, y, z, beyond `lower` [m]"""


class RobotFile(Strict):
    """A robot and its stages."""

    format: Format = 1
    """number of the file format"""
    name: str
    """name of the robot in recordings, reports and calibrations"""
    source: str = ""
    """source of the numbers in this file"""
    base: BaseFile = BaseFile()
    """pose of the robot's front plate"""
    tubes: Annotated[tuple[TubeFile, ...], Row]
    """tubes of the robot, 1 to 5, the innermost first"""
    joints: tuple[JointFile, ...] = Field(min_length=1, strict=False)
    """stages of the robot, in the order of every list of joints"""
    working_pose: Mapping[str, float] | None = None
    """joint positions to move to after homing, from which motions have room [rad or m]; none: no such move"""
    workspace: WorkspaceBoxFile | None = None
    """bounds of the tip, world frame; none: the joint limits alone bound it"""
    max_force: Positive | None = None
    """largest force on the tip, above which a motion ends in HOLD [N]; default: the force that tubes and base sensors
    can bear, 0.94 N for the preset `paper` (`core/robot/strength.py`)"""

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
                )
                for tube in self.tubes
            ),
            tuple(Joint(joint.name, index[joint.tube], joint.motion) for joint in self.joints),
            Base(self.base.position, self.base.rotation_vector),
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
        if (order := TubeOrder.of(robot, joints)) is not None:
            others.append(order)
        if self.workspace is not None:
            others.append(Workspace(self.workspace.lower, self.workspace.upper))
        if self.max_force is not None:
            others.append(ForceLimit(self.max_force))
        overload = force_bound(robot, joints) if self.max_force is None else None
        return Limits(joints, others=tuple(others), overload=overload)

    def largest_force(self) -> ForceBound:
        """Return the largest force on the tip: `max_force`, or what tubes and sensors can bear."""
        if (computed := self.limits().overload) is not None:
            return computed
        return ForceBound(self.max_force or math.inf, "max_force of the robot's file")


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
        robot, limits = file.robot(), file.limits()
        if file.working_pose is not None:
            check_pose(Statics(robot), limits, named_pose(file.working_pose, file, "working_pose"))
    except CtrError as error:
        raise ConfigError(f"{source}: {error}{line_reference(table, str(error))}") from None
    return file


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
