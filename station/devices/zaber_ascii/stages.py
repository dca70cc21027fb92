"""The driver of Zaber stages with the ASCII protocol: one chain of devices on one port."""

from collections.abc import Sequence

from station.config.controllers import StagesLatency
from station.config.robots import RobotFile
from station.devices.interfaces import Clock
from station.devices.kernel.answered import Answer
from station.devices.kernel.axis import joint_setups
from station.devices.kernel.driver import on_ports
from station.devices.kernel.emergency import stop_answering
from station.devices.kernel.line import LEAD_S
from station.devices.kernel.stages import LineStages
from station.devices.zaber_ascii.chain import AsciiWire
from station.devices.zaber_ascii.protocol import BAUD, BYTE_TIME_S, encode
from station.devices.zaber_ascii.sequences import AsciiProtocol
from station.devices.zaber_ascii.setup import AsciiFile, AsciiSetup, AsciiStageFile


def _setups(file: AsciiFile, robot: RobotFile) -> list[AsciiSetup]:
    address = ("device", lambda stage: (stage.device, stage.axis))
    return joint_setups(robot, file.joints, lambda number: AsciiStageFile(device=number), AsciiSetup.of, address)


def _latency(setups: Sequence[AsciiSetup], file: AsciiFile) -> StagesLatency:  # noqa: ARG001 - no option changes it
    """Return the latency of Zaber stages with the ASCII protocol.

    The interval is the time for the velocities of all axes, of up to 30 characters each (2.6 ms), and one position
    query of 20 (1.7 ms): 9.5 ms for three axes, 17.2 ms for six. The delay is the 2.6 ms of a velocity on the line, and
    the time by which it is passed to the port before the line is free: at most 2 ms, on average 1 ms.
    """
    velocities = [BYTE_TIME_S * len(encode(s.device, s.axis, 0, f"move vel -{s.top}")) for s in setups]
    query = BYTE_TIME_S * len(encode(1, 1, 0, "get pos"))
    return StagesLatency(sum(velocities) + query, 0.5 * LEAD_S + max(velocities))


def _stop(setups: Sequence[AsciiSetup], file: AsciiFile, clock: Clock) -> str:
    return stop_answering(file.port, BAUD, AsciiWire(setups), [str(setup.device) for setup in setups], clock)


ZABER_ASCII = on_ports(
    AsciiFile,
    _setups,
    lambda _: BAUD,
    lambda setups, ports, file: LineStages(AsciiProtocol(setups, file.deadline), ports, Answer),
    _latency,
    _stop,
)
