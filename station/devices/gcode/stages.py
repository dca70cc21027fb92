"""The driver of the axes of a G-code board."""

from collections.abc import Sequence
from typing import Literal

from station.config.controllers import PERIOD_S, StagesLatency
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.gcode.board import PROCESSING_S, QUEUE_S, SEGMENT_S, Answer, Request
from station.devices.gcode.emergency_stop import stop_board
from station.devices.gcode.protocol import BAUDS, Dialect
from station.devices.gcode.sequences import GcodeProtocol
from station.devices.gcode.setup import DEADLINE_S, LETTERS, AxisSetup, GcodeAxisFile, GcodeFile
from station.devices.interfaces import Clock
from station.devices.kernel.axis import STAGES_KEY, joint_setups
from station.devices.kernel.driver import on_ports
from station.devices.kernel.stages import LineStages, one_port
from station.devices.links.link import Link

#: Upper bound of the time for which a board's planner has segments [s]: at most 16, usually 3 to 4, of 10 ms each.
PLANNER_S = 0.2


def gcode_stages(
    setups: Sequence[AxisSetup],
    link: Link,
    dialect: Dialect,
    deadline: float = DEADLINE_S,
    baud: int = 0,
    homing: Literal["firmware", "here"] = "firmware",
) -> LineStages[Request, Answer]:
    """Return the driver of the axes of a G-code board."""
    protocol = GcodeProtocol(setups, dialect, baud, deadline, homing)
    return LineStages(protocol, one_port(link, setups), Answer, PLANNER_S)


def _setups(file: GcodeFile, robot: RobotFile) -> list[AxisSetup]:
    count = len(robot.joints)
    if count > len(LETTERS):
        raise ConfigError(f"{STAGES_KEY}: the robot has {count} joints; a board moves at most {len(LETTERS)} axes")
    address = ("letter", lambda axis: axis.letter)
    return joint_setups(
        robot, file.joints, lambda number: GcodeAxisFile(letter=LETTERS[number - 1]), AxisSetup.of, address
    )


#: Parts of a firmware's position report: text before the axes, text of each axis (twice for Marlin), and text after.
REPLIES: dict[Dialect, tuple[str, str, str]] = {
    "grbl": ("<Jog|MPos:", "-12.345,", "|FS:0,0>\r\n"),
    "marlin": ("Count ", "X:-12.34 X:-12345 ", "\r\nok\r\n"),
}


def _latency(setups: Sequence[AxisSetup], file: GcodeFile) -> StagesLatency:
    """Return the latency of the axes of a G-code board.

    The driver sends one segment every 10 ms, when the board's queue lasts for `QUEUE_S`, or for up to a tick less. The
    driver computes the length of the queue from reported positions. The age of a report when it is read is the sum of
    its time on the line, the board's processing, and half a tick. The true queue is shorter by this age. For three
    axes the age is 5.7 ms (GRBL) or 4.6 ms (Marlin), and the delay is 23 ms or 34 ms.
    """
    first, axis, last = REPLIES[file.dialect]
    length = len(first) + len(setups) * len(axis) + len(last)
    age = 10.0 / _baud(file) * length + PROCESSING_S + 0.5 * PERIOD_S
    return StagesLatency(SEGMENT_S, max(0.0, QUEUE_S[file.dialect] - 0.5 * PERIOD_S - age))


def _baud(file: GcodeFile) -> int:
    return file.baud or BAUDS[file.dialect]


def _stop(setups: Sequence[AxisSetup], file: GcodeFile, clock: Clock) -> str:
    return stop_board(file.port, _baud(file), file.dialect, [setup.letter for setup in setups], clock)


GCODE = on_ports(
    GcodeFile,
    _setups,
    _baud,
    lambda setups, ports, file: gcode_stages(
        setups, ports[0].link, file.dialect, file.deadline, _baud(file), file.homing
    ),
    _latency,
    _stop,
)
