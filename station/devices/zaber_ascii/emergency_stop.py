"""Emergency stop of Zaber ASCII stages without the control process, directly through their port.

The stop of all axes is repeated until each axis reports IDLE.
"""

from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.interfaces import Clock, EmergencyStop
from station.devices.links.link import SerialLink, lock_file
from station.devices.stop_on_port import TIMEOUT_S, stop_on_port
from station.devices.zaber_ascii.protocol import BAUD, LineReader, Reply, encode
from station.devices.zaber_ascii.setup import AsciiFile
from station.devices.zaber_ascii.stages import stage_files

#: Message IDs of the stop and of the status query, whose replies are thus distinguished from those to other commands.
STOP_ID, STATUS_ID = 98, 99
#: The first character ends a line that another process may have started.
STOP_BYTES = b"\n" + encode(0, 0, STOP_ID, "stop")
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
    moving, stages = set(axes), f"{len(axes)} stages"

    def confirmed(link: SerialLink) -> bool:
        nonlocal moving
        link.write(b"".join(encode(device, axis, STATUS_ID, "") for device, axis in sorted(moving)))
        moving -= _idle_axes(link, clock, moving)
        return not moving

    def unconfirmed() -> str:
        return f"number {', '.join(str(device) for device, _ in sorted(moving))}"

    return stop_on_port(port, BAUD, STOP_BYTES, confirmed, clock, patience, stages, unconfirmed)


def _idle_axes(link: SerialLink, clock: Clock, moving: Axes) -> Axes:
    """Return the axes that report IDLE to a status query, once all `moving` do or after `REPEAT_INTERVAL_S`."""
    reader, end, idle = LineReader(), clock.now() + REPEAT_INTERVAL_S, set[tuple[int, int]]()
    while clock.now() < end and not idle >= moving:
        for message in reader.feed(link.read()):
            if isinstance(message, Reply) and message.identity == STATUS_ID and not message.busy:
                idle.add((message.device, message.axis))
        clock.sleep(0.002)
    return idle
