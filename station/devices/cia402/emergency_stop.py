"""Emergency stop of CANopen drives without the control process, directly through their adapter.

The quick stop of all drives is repeated until each drive reports that it is stopped, and the same position twice.
If this stop fails, the drives still stop by themselves, because the heartbeat of the control process is missing.
"""

import itertools
import math
from collections.abc import Set

from station.devices.cia402.protocol import (
    COMMAND,
    CONTROLWORD,
    ENABLED,
    OPEN_ADAPTER,
    POSITION,
    QUICK_STOP,
    SDO_REPLY,
    STATE_MASK,
    STATUSWORD,
    Frame,
    FrameReader,
    download,
    encode,
    sdo_reply,
    upload,
)
from station.devices.interfaces import Clock
from station.devices.kernel.emergency import stop_on_port
from station.devices.links.link import SerialLink

BAUD = 1_000_000  #: rate of adapters with a real serial port; those with USB ignore it [bit/s]
REPEAT_INTERVAL_S = 0.02  #: interval of quick stops and requests [s]


def stop_drives(port: str, nodes: Set[int], clock: Clock) -> str:
    """Stop all drives on the bus and return a human-readable result.

    Raises:
        NotStopped: a drive has not reported that it is at rest.
    """
    reader, moving, drives = FrameReader(), set(nodes), f"{len(nodes)} drives"
    last, enabled = dict.fromkeys(nodes, math.nan), set(nodes)  # positions, and drives that are not known to be stopped
    stop = QUICK_STOP.to_bytes(2, "little")
    # Some time after the last heartbeat of the control process, the drives execute only SDOs, and one at a time.
    requests = itertools.cycle((None, STATUSWORD, POSITION))

    def confirmed(link: SerialLink) -> bool:
        entry = next(requests)
        asked = [
            upload(node, entry) if entry else download(node, CONTROLWORD, QUICK_STOP, 2) for node in sorted(moving)
        ]
        link.write(b"".join(map(encode, asked)))
        clock.sleep(REPEAT_INTERVAL_S)
        for identifier, data in reader.feed(link.read()):
            node, reply = identifier - SDO_REPLY, sdo_reply(data)
            if node not in moving or reply is None or not reply.accepted:
                continue
            if reply.entry == STATUSWORD and reply.value & STATE_MASK != ENABLED:
                enabled.discard(node)
            elif reply.entry == POSITION:
                if node not in enabled and last[node] == reply.value:
                    moving.discard(node)
                last[node] = reply.value
        return not moving

    def unconfirmed() -> str:
        return f"node {', '.join(map(str, sorted(moving)))}"

    frames = b"".join(encode(Frame(COMMAND + node, stop + bytes(4))) for node in sorted(nodes))
    return stop_on_port(port, BAUD, frames, confirmed, clock, drives, unconfirmed, OPEN_ADAPTER)
