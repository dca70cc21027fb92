"""How a simulated Aurora tells a frame: the replies to BX and TX."""

import struct
from collections.abc import Sequence

from station.devices.aurora.protocol import binary, framed
from station.devices.aurora.replies import OUT_OF_VOLUME
from station.lab.aurora.coil import Seen
from station.lab.aurora.commands import Refused
from station.lab.aurora.ports import Port

FIT_ERROR = 0.12  #: the figure that comes with a transform [mm]
OPTION_TRANSFORMS, OPTION_BEYOND_VOLUME = 0x0001, 0x0800


def wants_beyond_volume(options: int) -> bool:
    """Whether the reply `options` ask for transforms outside the volume too.

    Raises:
        Refused: they ask for what it has not.
    """
    if not options & OPTION_TRANSFORMS:
        raise Refused(0x23)
    if options & ~(OPTION_TRANSFORMS | OPTION_BEYOND_VOLUME):
        raise Refused(0x33)
    return bool(options & OPTION_BEYOND_VOLUME)


def bx_reply(tools: Sequence[tuple[Port, Seen | None]], beyond: bool, system_status: int) -> bytes:
    """All enabled ports and what is seen of their coils, in binary."""
    body = bytes([len(tools)]) + b"".join(_bx_tool(port, seen, beyond) for port, seen in tools)
    return binary(body + struct.pack("<H", system_status))


def tx_reply(tools: Sequence[tuple[Port, Seen | None]], beyond: bool, system_status: int) -> bytes:
    """All enabled ports and what is seen of their coils, in text."""
    text = f"{len(tools):02X}" + "".join(_tx_tool(port, seen, beyond) for port, seen in tools)
    return framed(text + f"{system_status:04X}")


def _status(port: Port, seen: Seen | None) -> int:
    return port.status | (OUT_OF_VOLUME if seen is not None and not port.gone and seen.beyond > 0.0 else 0)


def _visible(seen: Seen | None, beyond: bool) -> bool:
    return seen is not None and not seen.lost and (beyond or seen.beyond <= 0.0)


def _bx_tool(port: Port, seen: Seen | None, beyond: bool) -> bytes:
    if port.gone:
        return bytes([port.handle, 0x04])
    tail = struct.pack("<II", _status(port, seen), seen.frame if seen else 0)
    if seen is None or not _visible(seen, beyond):
        return bytes([port.handle, 0x02]) + tail
    return bytes([port.handle, 0x01]) + struct.pack("<8f", *seen.quaternion, *seen.position, FIT_ERROR) + tail


def _tx_tool(port: Port, seen: Seen | None, beyond: bool) -> str:
    if port.gone:
        return f"{port.handle:02X}UNOCCUPIED\n"
    tail = f"{_status(port, seen):08X}{seen.frame if seen else 0:08X}\n"
    if seen is None or not _visible(seen, beyond):
        return f"{port.handle:02X}MISSING{tail}"
    rotation = "".join(f"{round(1e4 * value):+06d}" for value in seen.quaternion)
    position = "".join(f"{round(1e2 * value):+07d}" for value in seen.position)
    return f"{port.handle:02X}{rotation}{position}{round(1e4 * FIT_ERROR):+06d}{tail}"
