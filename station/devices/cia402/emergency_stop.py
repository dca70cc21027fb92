"""Emergency stop of CANopen drives without the control process, directly through their adapter.

A dying control process may keep the port open for some milliseconds, and may have sent half a line. So this module
retries to open the port, and repeats the quick stop of all drives until each drive reports its stop. Without this
module the drives stop by themselves, because the heartbeat of the control process is missing.
"""

from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.cia402.protocol import (
    COMMAND,
    ENABLED,
    OPEN_ADAPTER,
    QUICK_STOP,
    STATE_MASK,
    STATUS,
    SYNC,
    Frame,
    FrameReader,
    encode,
)
from station.devices.cia402.setup import Cia402File
from station.devices.cia402.stages import BAUD, drive_setups
from station.devices.interfaces import Clock, EmergencyStop, NotStopped
from station.devices.links.link import LinkError, SerialLink, lock_file

TIMEOUT_S = 2.0  #: time limit of the stop [s]
REPEAT_INTERVAL_S = 0.02  #: interval of quick stops and SYNCs [s]


def cia402_emergency_stop(options: Mapping[str, Any], robot: RobotFile) -> EmergencyStop:
    """Return the emergency stop of the drives in `[devices.stages]`."""
    file = check(Cia402File, options, "devices.stages")
    nodes = {setup.node for setup in drive_setups(file, robot, "devices.stages")}
    lock_file(file.port)  # finds the folder for temporary files now, because the search writes a test file there
    return partial(stop_drives, file.port, nodes)


def stop_drives(port: str, nodes: Set[int], clock: Clock, patience: float = TIMEOUT_S) -> str:
    """Stop all drives on the bus and return a human-readable result; `patience` is the time limit [s].

    Raises:
        NotStopped: a drive has not reported that it is at rest.
    """
    start, problem = clock.now(), "no time"
    link: SerialLink | None = None
    reader, last = FrameReader(), dict[int, bytes]()
    commanded, moving = 0.0, set(nodes)
    stop = b"".join(
        encode(Frame(COMMAND + node, QUICK_STOP.to_bytes(2, "little") + bytes(4))) for node in sorted(nodes)
    )
    try:
        while clock.now() - start < patience:
            try:
                if link is None:
                    link = SerialLink(port, BAUD)
                    link.write(OPEN_ADAPTER)
                link.write(stop + encode(Frame(SYNC, b"")))
                commanded = commanded or clock.now()
                clock.sleep(REPEAT_INTERVAL_S)
                for identifier, data in reader.feed(link.read()):
                    node, word = identifier - STATUS, int.from_bytes(data[:2], "little")
                    if node in moving and len(data) == 6:
                        if word & STATE_MASK != ENABLED and last.get(node) == data[2:]:
                            moving.discard(node)
                        last[node] = data[2:]
                if not moving:
                    delay = 1e3 * (commanded - start)
                    return f"{len(nodes)} drives on {port} stop, commanded {delay:.0f} ms after detection"
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
        raise NotStopped(f"the drives on {port} cannot be commanded to stop ({problem}): press the emergency stop")
    silent = ", ".join(map(str, sorted(moving)))
    raise NotStopped(
        f"of {len(nodes)} drives on {port} node {silent} was commanded to stop and has not confirmed:"
        " press the emergency stop"
    )
