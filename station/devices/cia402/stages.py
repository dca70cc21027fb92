"""The driver of CANopen drives: the drives of one bus behind a serial CAN adapter."""

from collections.abc import Sequence

from station.config.controllers import StagesLatency
from station.config.robots import RobotFile
from station.devices.cia402.bus import DEADLINE_S, PERIOD_S, Answer, Request
from station.devices.cia402.emergency_stop import BAUD, stop_drives
from station.devices.cia402.protocol import COMMAND, STATUS, SYNC, Frame
from station.devices.cia402.sequences import WATCHDOG_MARGIN_S, DriveProtocol
from station.devices.cia402.setup import Cia402File, DriveFile, DriveSetup
from station.devices.kernel.axis import joint_setups
from station.devices.kernel.driver import on_ports
from station.devices.kernel.stages import LineStages, one_port
from station.devices.links.link import Link


def cia402_stages(
    setups: Sequence[DriveSetup], link: Link, deadline: float = DEADLINE_S
) -> LineStages[Request, Answer]:
    """Return the driver of the drives on a bus."""
    protocol = DriveProtocol(setups, deadline)
    return LineStages(protocol, one_port(link, setups), Answer, deadline + WATCHDOG_MARGIN_S)


def _setups(file: Cia402File, robot: RobotFile) -> list[DriveSetup]:
    address = ("node", lambda drive: drive.node)
    return joint_setups(robot, file.joints, lambda number: DriveFile(node=number), DriveSetup.of, address)


def _latency(setups: Sequence[DriveSetup], file: Cia402File) -> StagesLatency:  # noqa: ARG001 - no option changes it
    """Return the latency of CANopen drives.

    In every period of 4 ms the bus carries the SYNC, the answer of each drive, and then a velocity for each drive. The
    middle one of three drives receives its velocity after 0.6 ms, that of six after 1.2 ms. A USB adapter sends every
    millisecond and adds 0.5 ms on average. The mean wait for the next period is half a period less 1 ms, half a tick
    of the control loop, because all velocities of a cycle are sent in the tick in which they were computed.
    """
    drives = len(setups)
    answer, velocity = Frame(STATUS, bytes(6)).duration, Frame(COMMAND, bytes(6)).duration
    return StagesLatency(PERIOD_S, Frame(SYNC, b"").duration + drives * answer + 0.5 * (drives + 1) * velocity)


CIA402 = on_ports(
    Cia402File,
    _setups,
    lambda _: BAUD,
    lambda setups, ports, file: cia402_stages(setups, ports[0].link, file.deadline),
    _latency,
    lambda setups, file, clock: stop_drives(file.port, {setup.node for setup in setups}, clock),
)
