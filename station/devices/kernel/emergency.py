"""Emergency stop of the stages on one port without the control process: retries until the stages confirm their stop.

A dying control process may keep the port open for some milliseconds, and may have sent half a line.
"""

from collections.abc import Callable, Sequence

from station.devices.interfaces import Clock, NotStopped
from station.devices.kernel.answered import Wire
from station.devices.links.link import LinkError, SerialLink

TIMEOUT_S = 2.0  #: time limit of the stop [s]
REOPEN_INTERVAL_S = 0.002  #: interval of attempts to open the port [s]
QUERY_INTERVAL_S = 0.1  #: interval of stops and position queries of axes that answer each command [s]


def stop_on_port(
    port: str,
    baud: int,
    stop: bytes,
    confirmed: Callable[[SerialLink], bool],
    clock: Clock,
    stages: str,
    unconfirmed: Callable[[], str],
    opening: bytes = b"",
) -> str:
    """Send `stop` until the stages confirm it, and return a human-readable result.

    Args:
        port, baud: the port and its baud rate [bit/s].
        stop: bytes that stop every stage.
        confirmed: reads replies until the next stop is due; returns whether every stage has confirmed its stop.
        clock: clock of the calling process.
        stages: number and kind of the stages for the result, such as `3 stages`.
        unconfirmed: returns the stages that have not confirmed, for the error.
        opening: bytes that are sent once after the port was opened.

    Raises:
        NotStopped: a stage has not confirmed its stop.
    """
    start, problem, commanded = clock.now(), "no time", 0.0
    link: SerialLink | None = None
    try:
        while clock.now() - start < TIMEOUT_S:
            try:
                if link is None:
                    link = SerialLink(port, baud)
                    link.write(opening)
                link.write(stop)
                commanded = commanded or clock.now()
                if confirmed(link):
                    delay = 1e3 * (commanded - start)
                    return f"{stages} on {port} stop, commanded {delay:.0f} ms after the emergency stop started"
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
        f"{stages} on {port}: {unconfirmed()} was commanded to stop and has not confirmed: press the emergency stop"
    )


def stop_answering(port: str, baud: int, wire: Wire, names: Sequence[str], clock: Clock) -> str:
    """Stop all axes on a line and return a human-readable result.

    The stop of all axes is repeated until each axis, in its answer to a position query, reports that it does not move.
    `names`: numbers of the axes, for the error.

    Raises:
        NotStopped: an axis has not reported that it is at rest.
    """
    moving, query = set(range(len(names))), wire.max_number  # command number of the position queries only

    def confirmed(link: SerialLink) -> bool:
        link.write(b"".join(wire.encode(i, wire.position, query) for i in sorted(moving)))
        end = clock.now() + QUERY_INTERVAL_S
        while moving and clock.now() < end:
            for message in wire.read(link.read()):
                if message.number == query and message.answer.accepted and not message.answer.busy:
                    moving.difference_update(message.axes)
            clock.sleep(0.002)
        return not moving

    def unconfirmed() -> str:
        return f"number {', '.join(names[i] for i in sorted(moving))}"

    # The first character ends a line that another process may have started.
    stop, stages = b"\n" + wire.encode(None, wire.stop, query - 1), f"{len(names)} stages"
    return stop_on_port(port, baud, stop, confirmed, clock, stages, unconfirmed)
