"""Emergency stop of a G-code board without the control process, directly through its port.

The stop is repeated until the board reports the same position twice. Even if this stop fails, the stages stop at the
end of the last segment, within 0.04 s and the braking time.
"""

import math
from collections.abc import Sequence

from station.devices.gcode.protocol import HOLD, JOG_CANCEL, QUERY, RESET, Dialect, LineReader, Position, parse
from station.devices.interfaces import Clock
from station.devices.kernel.emergency import stop_on_port
from station.devices.links.link import SerialLink

REPEAT_INTERVAL_S = 0.04  #: interval of stops and queries [s]
LAST_RESORT_S = 0.5  #: time without a confirmation after which GRBL is reset, and Marlin is halted by M112 [s]
STOPS: dict[Dialect, bytes] = {"grbl": JOG_CANCEL + QUERY, "marlin": b"\nM410\nM114 R\n"}
LAST_RESORTS: dict[Dialect, bytes] = {"grbl": HOLD + RESET, "marlin": b"\nM112\n"}


def stop_board(port: str, baud: int, dialect: Dialect, letters: Sequence[str], clock: Clock) -> str:
    """Stop all axes of the board and return a human-readable result.

    Raises:
        NotStopped: the board has not reported that it is at rest.
    """
    reader, last, last_resort = LineReader(), tuple[float, ...](), 0.0

    def confirmed(link: SerialLink) -> bool:
        nonlocal last, last_resort
        # A silent Marlin may be starting, because opening its port resets it. M112 would halt it until a manual reset.
        if not last_resort and (dialect == "grbl" or reader.last):
            last_resort = clock.now() + LAST_RESORT_S
        if last_resort and clock.now() > last_resort:
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
    return stop_on_port(port, baud, STOPS[dialect], confirmed, clock, stages, lambda: "every one")
