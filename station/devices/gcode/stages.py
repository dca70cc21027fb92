"""Options of a G-code board, and the driver that they open."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import ConfigError, check
from station.devices.config import in_order
from station.devices.gcode.board import Answer, Request
from station.devices.gcode.protocol import BAUDS, Dialect
from station.devices.gcode.sequences import GcodeState
from station.devices.gcode.setup import DEADLINE_S, LETTERS, AxisSetup, GcodeAxisFile, GcodeFile
from station.devices.links.link import Link, SerialLink
from station.devices.stages_on_line import StagesOnLine

#: Time for which the segments in a board's planner last [s]: 16 segments of 10 ms, and usually three to four.
PLANNER_S = 0.2


def gcode_stages(
    setups: Sequence[AxisSetup],
    link: Link,
    dialect: Dialect,
    deadline: float = DEADLINE_S,
    baud: int = 0,
    homing: Literal["firmware", "here"] = "firmware",
) -> StagesOnLine[Request, Answer]:
    """Return the driver of the axes of a G-code board."""
    return StagesOnLine(GcodeState(setups, dialect, baud, deadline, homing), link, Answer, PLANNER_S)


def axis_setups(file: GcodeFile, robot: RobotFile, key: str) -> list[AxisSetup]:
    """Return the setup of each joint; raises ConfigError."""
    names = [joint.name for joint in robot.joints]
    if not file.joints and len(names) > len(LETTERS):
        raise ConfigError(f"{key}: the robot has {len(names)} joints; a board moves at most {len(LETTERS)} axes")
    axes = (
        in_order(file.joints, names, f"{key}.joints")
        if file.joints
        else [GcodeAxisFile(letter=letter) for letter, _ in zip(LETTERS, names, strict=False)]
    )
    taken: dict[str, str] = {}
    for name, axis in zip(names, axes, strict=True):
        if (other := taken.setdefault(axis.letter, name)) != name:
            raise ConfigError(f"{key}.joints.{name}.letter = '{axis.letter}': {other} has the same letter")
    try:
        return [AxisSetup.of(joint, axis) for joint, axis in zip(robot.joints, axes, strict=True)]
    except CtrError as error:
        raise ConfigError(f"{key}.joints.{error}") from None


def gcode(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], StagesOnLine[Request, Answer]]:
    """Return the opener of the axes of a G-code board; raises ConfigError."""
    key = "devices.stages"
    file = check(GcodeFile, options, key)
    setups, baud = axis_setups(file, robot, key), file.baud or BAUDS[file.dialect]
    return lambda: gcode_stages(setups, SerialLink(file.port, baud), file.dialect, file.deadline, baud, file.homing)
