"""Emergency stop of the stages on one port without the control process: retries until the stages confirm their stop.

A dying control process may keep the port open for some milliseconds, and may have sent half a line.
"""

from collections.abc import Callable

from station.devices.interfaces import Clock, NotStopped
from station.devices.links.link import LinkError, SerialLink

TIMEOUT_S = 2.0  #: time limit of the stop [s]
REOPEN_INTERVAL_S = 0.002  #: interval of attempts to open the port [s]


def stop_on_port(
    port: str,
    baud: int,
    stop: bytes,
    confirmed: Callable[[SerialLink], bool],
    clock: Clock,
    patience: float,
    stages: str,
    unconfirmed: Callable[[], str],
    opening: bytes = b"",
) -> str:
    """Send `stop` until the stages confirm it, and return a human-readable result.

    Args:
        port, baud: the port and its baud rate [bit/s].
        stop: bytes that stop every stage.
        confirmed: reads replies for the interval of two stops, and returns whether every stage has confirmed its stop.
        clock: clock of the calling process.
        patience: time limit [s].
        stages: number and kind of the stages, for the result.
        unconfirmed: returns the stages that have not confirmed, for the error.
        opening: bytes that are sent once after the port was opened.

    Raises:
        NotStopped: a stage has not confirmed its stop.
    """
    start, problem, commanded = clock.now(), "no time", 0.0
    link: SerialLink | None = None
    try:
        while clock.now() - start < patience:
            try:
                if link is None:
                    link = SerialLink(port, baud)
                    link.write(opening)
                link.write(stop)
                commanded = commanded or clock.now()
                if confirmed(link):
                    delay = 1e3 * (commanded - start)
                    return f"{stages} on {port} stop, commanded {delay:.0f} ms after detection"
            except LinkError as error:
                problem = str(error)
                if link is not None:
                    link.close()
                link = None
                clock.sleep(REOPEN_INTERVAL_S)
    finally:
        if link is not None:
            link.close()
    if not commanded:
        raise NotStopped(f"the stages on {port} cannot be commanded to stop ({problem}): press the emergency stop")
    raise NotStopped(
        f"of {stages} on {port} {unconfirmed()} was commanded to stop and has not confirmed: press the emergency stop"
    )
