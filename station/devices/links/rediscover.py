"""Finding a serial port again: a USB adapter that was unplugged may come back under another name.

It is known by its serial number, or, as many have none, by the socket that it is plugged into. What hangs on it
is identified by its driver afterwards.
"""

import os
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from serial.tools import list_ports


class UsbPort(NamedTuple):
    """A serial port on USB, as the system describes it."""

    device: str  #: /dev/ttyUSB0, COM3
    vendor: int
    product: int
    serial: str  #: of the adapter; "" if it has none
    location: str  #: bus, sockets on the way, and the interface on an adapter with several ports: 1-1.2:1.0

    def __str__(self) -> str:
        return f"USB adapter {self.vendor:04x}:{self.product:04x} " + (
            f"with serial number {self.serial}" if self.serial else f"at {self.location}"
        )


def usb_ports() -> list[UsbPort]:
    """The ports that are there now."""
    return [
        UsbPort(str(port.device), port.vid, port.pid, port.serial_number or "", port.location or "")
        for port in cast(Sequence[Any], list_ports.comports())
        if port.vid is not None and port.pid is not None
    ]


def describe(device: str, ports: Sequence[UsbPort]) -> UsbPort | None:
    """The one of `ports` that `device` names, itself or by a link to it; None if it is no USB port."""
    real = os.path.realpath(device)
    return next((port for port in ports if os.path.realpath(port.device) == real), None)


def find(known: UsbPort, ports: Sequence[UsbPort]) -> str | None:
    """The name under which a known adapter is among `ports`; None if it is not, or more than one may be it."""
    kin = [p for p in ports if (p.vendor, p.product, p.serial) == (known.vendor, known.product, known.serial)]
    if known.serial:
        # Ports of one adapter differ in the interface only, wherever it is plugged in.
        same = [p for p in kin if _interface(p) == _interface(known)]
    else:
        # The same socket; or another one, if there is no second adapter of the kind to mistake for it.
        same = [p for p in kin if p.location == known.location] or kin
    return same[0].device if len(same) == 1 else None


def _interface(port: UsbPort) -> str:
    return port.location.partition(":")[2]
