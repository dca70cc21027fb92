"""Emergency stop of Zaber ASCII stages without the control process, directly through their port.

A dying control process may keep the port open for some milliseconds, and may have sent half a line. So this module
retries to open the port, ends the line, and repeats the stop of all axes until each axis reports IDLE.
"""

from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.interfaces import Clock, EmergencyStop, NotStopped
from station.devices.links.link import LinkError, SerialLink, lock_file
from station.devices.zaber_ascii.protocol import BAUD, LineReader, Reply, encode
from station.devices.zaber_ascii.setup import AsciiFile
from station.devices.zaber_ascii.stages import stage_files

#: Message IDs of the stop and of the status query, whose replies are thus distinguished from those to other commands.
STOP_ID, STATUS_ID = 98, 99
#: The first character ends a line that another process may have started.
STOP_BYTES = b"\n" + encode(0, 0, STOP_ID, "stop")
TIMEOUT_S = 2.0  #: time limit of the stop [s]
REPEAT_INTERVAL_S = 0.1  #: interval of stops and status queries [s]

#: Device and axis numbers of the stages.
Axes = Set[tuple[int, int]]


def zaber_ascii_emergency_stop(options: Mapping[str, Any], robot: RobotFile) -> EmergencyStop:
    """Return the emergency stop of the chain in `[devices.stages]`."""
    file = check(AsciiFile, options, "devices.stages")
    axes = {(stage.device, stage.axis) for stage in stage_files(file, robot, "devices.stages")}
    lock_file(file.port)  # finds the folder for temporary files now, because the search writes a test file there
    return partial(stop_axes, file.port, axes)


def stop_axes(port: str, axes: Axes, clock: Clock, patience: float = TIMEOUT_S) -> str:
    """Stop all axes on the chain and return a human-readable result; `patience` is the time limit [s].

    Raises:
        NotStopped: an axis has not reported IDLE.
    """
    start, moving, problem = clock.now(), set(axes), "no time"
    link: SerialLink | None = None
    commanded = 0.0  # time of the first stop [s]
    try:
        while clock.now() - start < patience:
            try:
                link = link or SerialLink(port, BAUD)
                link.write(STOP_BYTES)
                commanded = commanded or clock.now()
                link.write(b"".join(encode(device, axis, STATUS_ID, "") for device, axis in sorted(moving)))
                moving -= _idle_axes(link, clock, moving)
                if not moving:
                    delay = 1e3 * (commanded - start)
                    return f"{len(axes)} stages on {port} stop, commanded {delay:.0f} ms after detection"
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
    silent = ", ".join(str(device) for device, _ in sorted(moving))
    raise NotStopped(
        f"of {len(axes)} stages on {port} number {silent} was commanded to stop and has not confirmed:"
        " press the emergency stop"
    )


def _idle_axes(link: SerialLink, clock: Clock, moving: Axes) -> Axes:
    """Return the axes that report IDLE to a status query, once all `moving` do or after `REPEAT_INTERVAL_S`."""
    reader, end, idle = LineReader(), clock.now() + REPEAT_INTERVAL_S, set[tuple[int, int]]()
    while clock.now() < end and not idle >= moving:
        for message in reader.feed(link.read()):
            if isinstance(message, Reply) and message.identity == STATUS_ID and not message.busy:
                idle.add((message.device, message.axis))
        clock.sleep(0.002)
    return idle
