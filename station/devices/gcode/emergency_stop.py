"""Emergency stop of a G-code board without the control process, directly through its port.

The stop is repeated until the board reports the same position twice. Without this module the stages stop at the end of
the last segment, within 0.04 s and the braking time.
"""

import math
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
from station.devices.interfaces import Clock, EmergencyStop
from station.devices.links.link import SerialLink, lock_file
from station.devices.stop_on_port import TIMEOUT_S, stop_on_port

REPEAT_INTERVAL_S = 0.04  #: interval of stops and queries [s]
LAST_RESORT_S = 0.5  #: time without a confirmation after which GRBL is reset, and Marlin is halted by M112 [s]
STOPS: dict[Dialect, bytes] = {"grbl": JOG_CANCEL + QUERY, "marlin": b"\nM410\nM114 R\n"}
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
    reader, last, last_resort = LineReader(), tuple[float, ...](), 0.0

    def confirmed(link: SerialLink) -> bool:
        nonlocal last, last_resort
        last_resort = last_resort or clock.now() + LAST_RESORT_S
        if clock.now() > last_resort:
            last_resort = math.inf
            link.write(LAST_RESORTS[dialect])
        clock.sleep(REPEAT_INTERVAL_S)
        for line in reader.feed(link.read()):
            message = parse(dialect, line, letters)
            if isinstance(message, Position):
                if message.values == last and message.state not in ("Jog", "Run", "Home"):
                    return True
                last = message.values
        return False

    stages = f"{len(letters)} stages"
    return stop_on_port(port, baud, STOPS[dialect], confirmed, clock, patience, stages, lambda: "every one")
