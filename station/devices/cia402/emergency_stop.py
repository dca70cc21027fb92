"""Emergency stop of CANopen drives without the control process, directly through their adapter.

The quick stop of all drives is repeated until each drive reports its stop. Without this module the drives stop by
themselves, because the heartbeat of the control process is missing.
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
from station.devices.interfaces import Clock, EmergencyStop
from station.devices.links.link import SerialLink, lock_file
from station.devices.stop_on_port import TIMEOUT_S, stop_on_port

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
    reader, last, moving, drives = FrameReader(), dict[int, bytes](), set(nodes), f"{len(nodes)} drives"
    stop = b"".join(
        encode(Frame(COMMAND + node, QUICK_STOP.to_bytes(2, "little") + bytes(4))) for node in sorted(nodes)
    )

    def confirmed(link: SerialLink) -> bool:
        clock.sleep(REPEAT_INTERVAL_S)
        for identifier, data in reader.feed(link.read()):
            node, word = identifier - STATUS, int.from_bytes(data[:2], "little")
            if node in moving and len(data) == 6:
                if word & STATE_MASK != ENABLED and last.get(node) == data[2:]:
                    moving.discard(node)
                last[node] = data[2:]
        return not moving

    def unconfirmed() -> str:
        return f"node {', '.join(map(str, sorted(moving)))}"

    stop += encode(Frame(SYNC, b""))
    return stop_on_port(port, BAUD, stop, confirmed, clock, patience, drives, unconfirmed, OPEN_ADAPTER)
