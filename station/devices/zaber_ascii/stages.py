"""Options of Zaber stages with the ASCII protocol, and the driver that they open: one chain of devices on one port."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import ConfigError, check
from station.devices.config import in_order
from station.devices.links.link import Link, SerialLink
from station.devices.stages_on_line import StagesOnLine
from station.devices.zaber_ascii.chain import DEADLINE_S, Answer, Request
from station.devices.zaber_ascii.protocol import BAUD
from station.devices.zaber_ascii.sequences import AsciiStagesState
from station.devices.zaber_ascii.setup import AsciiFile, AsciiSetup, AsciiStageFile


def ascii_stages(
    setups: Sequence[AsciiSetup], link: Link, deadline: float = DEADLINE_S
) -> StagesOnLine[Request, Answer]:
    """Return the driver of Zaber ASCII stages on a chain."""
    return StagesOnLine(AsciiStagesState(setups, deadline), link, Answer)


def stage_files(file: AsciiFile, robot: RobotFile, key: str) -> list[AsciiStageFile]:
    """Return the axis of each joint; raises ConfigError."""
    names = [joint.name for joint in robot.joints]
    stages = (
        in_order(file.joints, names, f"{key}.joints")
        if file.joints
        else [AsciiStageFile(device=number) for number, _ in enumerate(names, 1)]
    )
    taken: dict[tuple[int, int], str] = {}
    for name, stage in zip(names, stages, strict=True):
        other = taken.setdefault((stage.device, stage.axis), name)
        if other != name:
            raise ConfigError(
                f"{key}.joints.{name}.device = {stage.device}: {other} has the same device and axis; "
                "give each device of a chain a different number"
            )
    return stages


def zaber_ascii(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], StagesOnLine[Request, Answer]]:
    """Return the opener of Zaber stages with the ASCII protocol; raises ConfigError."""
    key = "devices.stages"
    file = check(AsciiFile, options, key)
    stages = stage_files(file, robot, key)
    try:
        setups = [AsciiSetup.of(joint, stage) for joint, stage in zip(robot.joints, stages, strict=True)]
    except CtrError as error:
        raise ConfigError(f"{key}.joints.{error}") from None
    return lambda: ascii_stages(setups, SerialLink(file.port, BAUD), file.deadline)
