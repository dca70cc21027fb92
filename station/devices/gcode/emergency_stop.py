"""Emergency stop of a G-code board without the control process, directly through its port.

A dying control process may keep the port open for some milliseconds, and may have sent half a line. So this module
retries to open the port, ends the line, and repeats the stop until the board reports the same position twice. Without
this module the stages stop at the end of the last segment, within 0.04 s and the braking time.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.gcode.protocol import (
    BAUDS,
    HOLD,
    JOG_CANCEL,
    QUERY,
    RESET,
    Dialect,
    LineReader,
    Position,
    parse,
)
from station.devices.gcode.setup import GcodeFile
from station.devices.gcode.stages import axis_setups
from station.devices.interfaces import Clock, EmergencyStop, NotStopped
from station.devices.links.link import LinkError, SerialLink, lock_file

TIMEOUT_S = 2.0  #: time limit of the stop [s]
REPEAT_INTERVAL_S = 0.04  #: interval of stops and queries [s]
LAST_RESORT_S = 0.5  #: time without a confirmation after which GRBL is reset, and Marlin is halted by M112 [s]
STOPS: dict[Dialect, bytes] = {"grbl": JOG_CANCEL + QUERY, "marlin": b"\nM410\nM114\n"}
LAST_RESORTS: dict[Dialect, bytes] = {"grbl": HOLD + RESET, "marlin": b"\nM112\n"}


def gcode_emergency_stop(options: Mapping[str, Any], robot: RobotFile) -> EmergencyStop:
    """Return the emergency stop of the board in `[devices.stages]`."""
    file = check(GcodeFile, options, "devices.stages")
    letters = [setup.letter for setup in axis_setups(file, robot, "devices.stages")]
    lock_file(file.port)  # finds the folder for temporary files now, because the search writes a test file there
    return partial(stop_board, file.port, file.baud or BAUDS[file.dialect], file.dialect, letters)


def stop_board(
    port: str, baud: int, dialect: Dialect, letters: Sequence[str], clock: Clock, patience: float = TIMEOUT_S
) -> str:
    """Stop all axes of the board and return a human-readable result; `patience` is the time limit [s].

    Raises:
        NotStopped: the board has not reported that it is at rest.
    """
    start, problem, commanded, forced = clock.now(), "no time", 0.0, False
    link: SerialLink | None = None
    reader, last = LineReader(), tuple[float, ...]()
    try:
        while clock.now() - start < patience:
            try:
                link = link or SerialLink(port, baud)
                link.write(STOPS[dialect])
                commanded = commanded or clock.now()
                if not forced and clock.now() - commanded > LAST_RESORT_S:
                    forced = True
                    link.write(LAST_RESORTS[dialect])
                clock.sleep(REPEAT_INTERVAL_S)
                for line in reader.feed(link.read()):
                    message = parse(dialect, line, letters)
                    if isinstance(message, Position):
                        if message.values == last and message.state not in ("Jog", "Run", "Home"):
                            delay = 1e3 * (commanded - start)
                            return f"{len(letters)} stages on {port} stop, commanded {delay:.0f} ms after detection"
                        last = message.values
            except LinkError as error:
                problem = str(error)
                if link is not None:
                    link.close()
                link = None
                clock.sleep(0.002)
    finally:
        if link is not None:
            link.close()
    if not commanded:
        raise NotStopped(f"the stages on {port} cannot be commanded to stop ({problem}): press the emergency stop")
    raise NotStopped(f"the board on {port} was commanded to stop and has not confirmed: press the emergency stop")
