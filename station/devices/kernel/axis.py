"""Setups of axes, read from their tables in the station file, and the conversion of counts to joint positions."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from core.errors import CtrError
from station.config.robots import JointFile, RobotFile
from station.config.strict import ConfigError
from station.devices.config import in_order, twins


class HomeOptions(Protocol):
    """Options of an axis that concern its home position."""

    home_at: float | None
    home_speed: float | None
    backwards: bool


def home_of(joint: JointFile, options: HomeOptions) -> tuple[float, float]:
    """Return the joint position at home [rad or m] and the speed of homing [rad/s or m/s], with their defaults."""
    start = joint.upper if options.backwards else joint.lower
    home_at = (0.0 if joint.motion == "rotation" else start) if options.home_at is None else options.home_at
    return home_at, 0.25 * joint.speed if options.home_speed is None else options.home_speed


@dataclass(frozen=True)
class CountedJoint:
    """A joint and the counts of its axis, usually 0 at the home position; one count is `joint.microstep`."""

    joint: JointFile
    home_at: float  #: joint position at home [rad or m]
    home_speed: float  #: speed of homing [rad/s or m/s]
    backwards: bool = field(default=False, kw_only=True)  #: whether the count increases when the position decreases

    @property
    def home_count(self) -> int:
        """Count of the axis at home [counts]."""
        return 0

    @property
    def step(self) -> float:
        """Change of the joint's position per count [rad or m]."""
        return -self.joint.microstep if self.backwards else self.joint.microstep

    @property
    def velocity_step(self) -> float:
        """Joint velocity per unit of a velocity command [rad/s or m/s]; by default the unit is a count per second."""
        return self.step

    @property
    def minimum(self) -> int:
        """First whole count inside the joint's travel."""
        return math.ceil(min(self._ends) - 1e-6)

    @property
    def maximum(self) -> int:
        """Last whole count inside the joint's travel."""
        return math.floor(max(self._ends) + 1e-6)

    @property
    def turn(self) -> int:
        """One turn of a rotation [counts]."""
        return round(2.0 * math.pi / self.joint.microstep)

    def position(self, counts: float, /) -> float:
        """Return the joint position at a count of the axis [rad or m]."""
        return self.home_at + self.step * (counts - self.home_count)

    @property
    def _ends(self) -> tuple[float, float]:
        return (self.joint.lower - self.home_at) / self.step, (self.joint.upper - self.home_at) / self.step


File = TypeVar("File")
Setup = TypeVar("Setup")
STAGES_KEY = "devices.stages"  #: table of the stages in a station file


def joint_setups(
    robot: RobotFile,
    tables: Mapping[str, File],
    default: Callable[[int], File],
    of: Callable[[JointFile, File], Setup],
    address: tuple[str, Callable[[File], object]],
) -> list[Setup]:
    """Return the setup of each joint of a robot.

    Args:
        robot: the robot.
        tables: table of each joint in the station file, by the joint's name; empty: the defaults.
        default: returns the default table of the joint with this number, which counts from 1.
        of: returns the setup of a joint from its table; may raise CtrError with the joint's name.
        address: key of the tables that has an axis's number, and function that returns what must differ between axes.

    Raises:
        ConfigError: a joint is missing or unknown, two joints have the same axis, or a value is out of its range.
    """
    names, (key, place) = [joint.name for joint in robot.joints], address
    files = in_order(tables, names, f"{STAGES_KEY}.joints") if tables else [default(k + 1) for k in range(len(names))]
    if same := twins({name: place(file) for name, file in zip(names, files, strict=True)}):
        raise ConfigError(
            f"{STAGES_KEY}.joints.{same[1]}.{key} = {getattr(files[names.index(same[1])], key)}: {same[0]} has the same"
            " axis; give each joint a different one"
        )
    try:
        return [of(joint, file) for joint, file in zip(robot.joints, files, strict=True)]
    except CtrError as error:
        raise ConfigError(f"{STAGES_KEY}.joints.{error}") from None
