"""The line of a simulated Aurora: a pipe in memory with a rate and a break, and a pump for any link."""

import contextlib

from station.devices.aurora import POWER_UP_BAUD
from station.devices.links import Link, LinkError
from station.lab.simulated_aurora import SimulatedAurora


class HostPort:
    """The host's end of a line in memory that, unlike a bare pipe, has a rate and carries a break."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.device = DeviceEnd(name)

    def read(self) -> bytes:
        """What has arrived."""
        return self.device.given()

    def write(self, data: bytes) -> None:
        """Send `data`."""
        self.device.take(data)

    def set_baud(self, baud: int) -> None:
        """Talk at another rate [bit/s]."""
        self.device.host_baud = baud

    def send_break(self) -> None:
        """Hold the line low for a moment."""
        self.device.broken = True

    def close(self) -> None:
        """Let go of it; the unit goes on."""


class DeviceEnd:
    """The unit's end of such a line."""

    def __init__(self, name: str) -> None:
        self.name = f"{name} (device)"
        self.host_baud = POWER_UP_BAUD
        self.broken = False  #: the host sent a break that nobody has seen yet
        self._to_device, self._to_host, self._open = bytearray(), bytearray(), True

    def read(self) -> bytes:
        """What the host has written."""
        data = bytes(self._to_device)
        self._to_device.clear()
        return data

    def write(self, data: bytes) -> None:
        """Give `data` to the host."""
        self._to_host += data

    def close(self) -> None:
        """Pull the cable."""
        self._open = False

    def take(self, data: bytes) -> None:
        """From the host's end."""
        if not self._open:
            raise LinkError(f"{self.name} is unplugged")
        self._to_device += data

    def given(self) -> bytes:
        """To the host's end."""
        if not self._open:
            raise LinkError(f"{self.name} is unplugged")
        data = bytes(self._to_host)
        self._to_host.clear()
        return data


def pump(link: Link, unit: SimulatedAurora, now: float) -> bool:
    """Move bytes between the device's end of any link and the unit; false once the link is gone.

    A link that knows the host's rate says so as `host_baud`, one that carries a break as `broken`.
    `now` [s] is virtual or real, the same time that `advance` counts.
    """
    if unit.faults.disconnected:
        link.close()
        return False
    if getattr(link, "broken", False):
        link.broken = False  # type: ignore[attr-defined]
        unit.restart(now)
    host_baud = getattr(link, "host_baud", None)
    with contextlib.suppress(LinkError):
        unit.receive(link.read(), now, host_baud)
        data = unit.transmit(now, host_baud)
        if data:
            link.write(data)
        return True
    return False
