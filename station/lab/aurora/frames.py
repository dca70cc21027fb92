"""Encodes the coils' frames as replies of a simulated Aurora tracker to the commands BX and TX."""

import struct
from collections.abc import Sequence

from station.devices.aurora.protocol import binary, framed
from station.devices.aurora.replies import OUT_OF_VOLUME
from station.lab.aurora.coil import CoilView
from station.lab.aurora.commands import AuroraRefusal
from station.lab.aurora.ports import ToolPort

FIT_ERROR = 0.12  #: fit error reported with a transform [mm]
OPTION_TRANSFORMS, OPTION_BEYOND_VOLUME = 0x0001, 0x0800


def requests_beyond_volume(options: int) -> bool:
    """Return whether `options` of BX or TX also request the transforms of tools outside the measurement volume.

    Raises:
        AuroraRefusal: the simulated tracker does not support a requested option.
    """
    if not options & OPTION_TRANSFORMS:
        raise AuroraRefusal(0x23)
    if options & ~(OPTION_TRANSFORMS | OPTION_BEYOND_VOLUME):
        raise AuroraRefusal(0x33)
    return bool(options & OPTION_BEYOND_VOLUME)


def bx_reply(tools: Sequence[tuple[ToolPort, CoilView | None]], beyond: bool, system_status: int) -> bytes:
    """Return the binary reply to BX: all enabled ports and the frames of their coils."""
    body = bytes([len(tools)]) + b"".join(_bx_tool(port, view, beyond) for port, view in tools)
    return binary(body + struct.pack("<H", system_status))


def tx_reply(tools: Sequence[tuple[ToolPort, CoilView | None]], beyond: bool, system_status: int) -> bytes:
    """Return the text reply to TX: all enabled ports and the frames of their coils."""
    text = f"{len(tools):02X}" + "".join(_tx_tool(port, view, beyond) for port, view in tools)
    return framed(text + f"{system_status:04X}")


def _status(port: ToolPort, view: CoilView | None) -> int:
    return port.status | (OUT_OF_VOLUME if view is not None and not port.gone and view.beyond > 0.0 else 0)


def _visible(view: CoilView | None, beyond: bool) -> bool:
    return view is not None and not view.lost and (beyond or view.beyond <= 0.0)


def _bx_tool(port: ToolPort, view: CoilView | None, beyond: bool) -> bytes:
    if port.gone:
        return bytes([port.handle, 0x04])
    tail = struct.pack("<II", _status(port, view), view.frame if view else 0)
    if view is None or not _visible(view, beyond):
        return bytes([port.handle, 0x02]) + tail
    return bytes([port.handle, 0x01]) + struct.pack("<8f", *view.quaternion, *view.position, FIT_ERROR) + tail


def _tx_tool(port: ToolPort, view: CoilView | None, beyond: bool) -> str:
    if port.gone:
        return f"{port.handle:02X}UNOCCUPIED\n"
    tail = f"{_status(port, view):08X}{view.frame if view else 0:08X}\n"
    if view is None or not _visible(view, beyond):
        return f"{port.handle:02X}MISSING{tail}"
    rotation = "".join(f"{round(1e4 * value):+06d}" for value in view.quaternion)
    position = "".join(f"{round(1e2 * value):+07d}" for value in view.position)
    return f"{port.handle:02X}{rotation}{position}{round(1e4 * FIT_ERROR):+06d}{tail}"
