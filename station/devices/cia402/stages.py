"""Options of CANopen drives, and the driver that they open: the drives of one bus behind a serial CAN adapter."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import ConfigError, check
from station.devices.cia402.bus import DEADLINE_S, Answer, Request
from station.devices.cia402.sequences import WATCHDOG_MARGIN_S, DrivesState
from station.devices.cia402.setup import Cia402File, DriveFile, DriveSetup
from station.devices.config import in_order
from station.devices.links.link import Link, SerialLink
from station.devices.stages_on_line import StagesOnLine

BAUD = 1_000_000  #: of adapters with a real serial port; those with USB ignore it [bit/s]


def cia402_stages(
    setups: Sequence[DriveSetup], link: Link, deadline: float = DEADLINE_S
) -> StagesOnLine[Request, Answer]:
    """Return the driver of the drives on a bus."""
    return StagesOnLine(DrivesState(setups, deadline), link, Answer, deadline + WATCHDOG_MARGIN_S)


def drive_setups(file: Cia402File, robot: RobotFile, key: str) -> list[DriveSetup]:
    """Return the drive of each joint.

    Raises:
        ConfigError: a joint is missing or unknown, two joints have one node, or a value is out of its range.
    """
    names = [joint.name for joint in robot.joints]
    drives = (
        in_order(file.joints, names, f"{key}.joints")
        if file.joints
        else [DriveFile(node=number) for number, _ in enumerate(names, 1)]
    )
    taken: dict[int, str] = {}
    for name, drive in zip(names, drives, strict=True):
        if taken.setdefault(drive.node, name) != name:
            raise ConfigError(
                f"{key}.joints.{name}.node = {drive.node}: {taken[drive.node]} has the same node number; "
                "give each drive of a bus a different one"
            )
    try:
        return [DriveSetup.of(joint, drive) for joint, drive in zip(robot.joints, drives, strict=True)]
    except CtrError as error:
        raise ConfigError(f"{key}.joints.{error}") from None


def cia402(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], StagesOnLine[Request, Answer]]:
    """Return the opener of CANopen drives; raises ConfigError."""
    key = "devices.stages"
    file = check(Cia402File, options, key)
    setups = drive_setups(file, robot, key)
    return lambda: cia402_stages(setups, SerialLink(file.port, BAUD), file.deadline)
