"""Finds a serial port again: a USB adapter that was unplugged may return under another name.

The adapter is recognised by its serial number or, if it has none, by its USB socket. Its driver then identifies the
device.
"""

import os
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from serial.tools import list_ports


class UsbPort(NamedTuple):
    """A serial port on USB, as the system describes it."""

    device: str  #: name of the port: /dev/ttyUSB0, COM3
    vendor: int
    product: int
    serial: str  #: serial number of the adapter; "" if it has none
    location: str  #: USB bus, chain of sockets, and interface on an adapter with several ports: 1-1.2:1.0

    def __str__(self) -> str:
        return f"USB adapter {self.vendor:04x}:{self.product:04x} " + (
            f"with serial number {self.serial}" if self.serial else f"at {self.location}"
        )


def usb_ports() -> list[UsbPort]:
    """Return the USB ports that are present."""
    return [
        UsbPort(str(port.device), port.vid, port.pid, port.serial_number or "", port.location or "")
        for port in cast(Sequence[Any], list_ports.comports())
        if port.vid is not None and port.pid is not None
    ]


def describe(device: str, ports: Sequence[UsbPort]) -> UsbPort | None:
    """Return the USB port that `device` names, directly or by a symbolic link; None if `device` is no USB port."""
    real = os.path.realpath(device)
    return next((port for port in ports if os.path.realpath(port.device) == real), None)


def find(known: UsbPort, ports: Sequence[UsbPort]) -> str | None:
    """Return the present name of a known adapter among `ports`; None if it is absent or ambiguous."""
    similar = [p for p in ports if (p.vendor, p.product, p.serial) == (known.vendor, known.product, known.serial)]
    if known.serial:
        # All ports of one adapter have the same serial number; they differ in the interface only.
        same = [p for p in similar if _interface(p) == _interface(known)]
    else:
        # Accept the same USB socket, or another socket if no second adapter of this kind is present.
        same = [p for p in similar if p.location == known.location] or similar
    return same[0].device if len(same) == 1 else None


def _interface(port: UsbPort) -> str:
    return port.location.partition(":")[2]
