"""Robot files: the TOML description of tubes, joints and the stages that move them."""

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from core.errors import CtrError
from core.robot.limits import ForceLimit, JointLimit, Limit, Limits, TubeOrder, Workspace
from core.robot.robot import Array, Base, Joint, Robot, Section, Tube
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
    on_line,
    parse_toml,
    preset,
    read_toml,
)

#: Standard gravity [m/s^2].
STANDARD = 9.80665


class SectionFile(Strict):
    """One piece of a tube, from the proximal end."""

    length: Positive
    """of the piece, along the tube [m]"""
    curvature: Annotated[tuple[float, float], Row] = (0.0, 0.0)
    """x, y in the tube's frame [1/m]; an arc of radius r that bends toward -y is [1/r, 0]"""


class TubeFile(Strict):
    """One tube; innermost first in the file."""

    name: Name
    """by which joints, labs, sensors and calibrations call it"""
    bending_stiffness: float
    """EI, greater than 0 [N m^2]"""
    poisson_ratio: float = 0.30
    """GJ = EI / (1 + poisson_ratio), -1 ... 0.5"""
    torsional_stiffness: float | None = None
    """GJ where it does not follow from EI and poisson_ratio (a patterned tube), greater than 0 [N m^2]"""
    rotation: float = 0.0
    """of a tube that no joint turns, any angle [rad]"""
    translation: float = 0.0
    """proximal end of a tube that no joint slides, behind the plate: not positive [m]"""
    outer_diameter: float
    """of its wall outside, greater than 0 [m]"""
    inner_diameter: float
    """of its wall inside, 0 ... outer_diameter [m]"""
    density: NotNegative = 0.0
    """of its material: calibration takes the tube's own weight from it and the diameters; 0 leaves it out [kg/m^3]"""
    sections: Annotated[tuple[SectionFile, ...], Row]
    """its pieces, from the proximal end to the distal one"""

    @property
    def weight(self) -> float:
        """Of its own [N/m]."""
        return STANDARD * self.density * 0.25 * math.pi * (self.outer_diameter**2 - self.inner_diameter**2)


class JointFile(Strict):
    """One stage and the tube it moves."""

    name: Name
    """by which start poses, station files, recordings and pages call it"""
    tube: str
    """that it moves, by name"""
    motion: Literal["rotation", "translation"]
    """what it does to the tube: turn it, or slide it along z"""
    lower: float
    """end of the travel, below `upper` [rad or m]"""
    upper: float
    """other end of the travel, above `lower` [rad or m]"""
    speed: float
    """that the stage never exceeds, greater than 0 [rad/s or m/s]"""
    acceleration: float
    """with which it can brake, greater than 0 [rad/s^2 or m/s^2]"""
    microstep: Positive
    """resolution of the stage [rad or m]"""


Three = Annotated[tuple[float, float, float], Row]


class BaseFile(Strict):
    """Where the front plate stands in the world."""

    position: Three = (0.0, 0.0, 0.0)
    """of its origin, any place [m]"""
    rotation_vector: Three = (0.0, 0.0, 0.0)
    """of its axes: axis times angle [rad]"""


class BoxFile(Strict):
    """Where the tip may be."""

    lower: Vector
    """corner with the smallest x, y, z [m]"""
    upper: Vector
    """corner with the largest x, y, z, beyond `lower` [m]"""


class RobotFile(Strict):
    """A robot and its stages."""

    format: Format = 1
    """of this file"""
    name: str
    """as recordings, reports and calibrations call it"""
    source: str = ""
    """where the numbers come from"""
    base: BaseFile = BaseFile()
    """where its front plate stands"""
    tubes: Annotated[tuple[TubeFile, ...], Row]
    """innermost first, 1 to 5 of them"""
    joints: tuple[JointFile, ...] = Field(min_length=1, strict=False)
    """its stages, in the order of every list of joints"""
    working_pose: Mapping[str, float] | None = None
    """joints from which motions have room: where the station goes after homing [rad or m]; none: it stays there"""
    workspace: BoxFile | None = None
    """of the tip, world frame; none leaves what the joints reach"""
    max_force: Positive | None = None
    """against which the tip does not push on; none: against any [N]"""

    def robot(self) -> Robot:
        """The description that the model works on."""
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
        """What the stages allow."""
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
        others: list[Limit] = []
        if (order := TubeOrder.of(self.robot(), joints)) is not None:
            others.append(order)
        if self.workspace is not None:
            others.append(Workspace(self.workspace.lower, self.workspace.upper))
        if self.max_force is not None:
            others.append(ForceLimit(self.max_force))
        return Limits(joints, others=tuple(others))


def load_robot(name: str) -> RobotFile:
    """A robot by preset name or by file; building it checks what pydantic cannot.

    Raises:
        ConfigError: with file, key and value.
    """
    path = preset("robots", name)
    return _checked(read_toml(path), str(path))


def robot_of(text: str, source: str) -> RobotFile:
    """A robot by what its file says; `source` is for messages.

    Raises:
        ConfigError: with source, key and value.
    """
    return _checked(parse_toml(text, source), source)


def _checked(table: Document, source: str) -> RobotFile:
    file = check(RobotFile, table, source)
    try:
        robot, limits = file.robot(), file.limits()
        if file.working_pose is not None:
            limits.check(pose := named_pose(file.working_pose, file, "working_pose"))
            robot.check_pose(pose)
    except CtrError as error:
        raise ConfigError(f"{source}: {error}{on_line(table, str(error))}") from None
    return file


def named_pose(joints: Mapping[str, float], robot: RobotFile, key: str) -> Array:
    """Joint positions (n,) by name [rad or m]; `key` is where they stand, for messages.

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
    """Joint positions (n,) of a start [rad or m].

    Raises:
        ConfigError: joints are missing or unknown.
    """
    return named_pose(start, robot, "start")
