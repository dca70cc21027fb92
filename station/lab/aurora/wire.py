"""The line of a simulated Aurora: a pipe in memory with a rate and a break, and a pump for any link."""

from station.devices.aurora.protocol import POWER_UP_BAUD
from station.devices.links.link import Link, LinkError
from station.devices.links.memory_pipe import Cable
from station.lab.aurora.simulated import SimulatedAurora

BUFFER = 4096  #: of a port, each way; what it does not hold is lost [bytes]


class HostPort:
    """The host's end of a line in memory that, unlike a bare pipe, has a rate and carries a break."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.device = DeviceEnd(name)
        self._pulls = 0

    def read(self) -> bytes:
        """What has arrived."""
        self._check()
        return self.device.given()

    def write(self, data: bytes) -> None:
        """Send `data`."""
        self._check()
        self.device.take(data)

    def reopen(self) -> None:
        """Take part again; raises LinkError while it is unplugged."""
        if not self.device.cable.plugged:
            raise LinkError(f"{self.name} cannot be opened: it is not plugged in")
        self.device.given()
        self._pulls = self.device.cable.pulls

    def set_baud(self, baud: int) -> None:
        """Talk at another rate [bit/s]."""
        self.device.host_baud = baud

    def set_break(self, low: bool) -> None:
        """Hold the line low, or let it go again."""
        self.device.broken |= low

    def close(self) -> None:
        """Let go of it; the unit goes on."""

    def _check(self) -> None:
        if self._pulls != self.device.cable.pulls:
            raise LinkError(f"{self.name} is gone: unplugged")


class DeviceEnd:
    """The unit's end of such a line."""

    def __init__(self, name: str) -> None:
        self.name = f"{name} (device)"
        self.host_baud = POWER_UP_BAUD
        self.broken = False  #: the host sent a break that nobody has seen yet
        self.cable = Cable()
        self._to_device, self._to_host = bytearray(), bytearray()

    def read(self) -> bytes:
        """What the host has written."""
        return _emptied(self._to_device)

    def write(self, data: bytes) -> None:
        """Give `data` to the host."""
        if self.cable.plugged:
            self._to_host += data[: BUFFER - len(self._to_host)]

    def unplug(self) -> None:
        """Pull the cable: the host's port is gone."""
        self.cable.unplug()
        self._to_device.clear()

    def plug(self) -> None:
        """Put it back: the host may open its port anew."""
        self.cable.plug()

    def close(self) -> None:
        """Pull the cable for good."""
        self.unplug()

    def take(self, data: bytes) -> None:
        """From the host's end."""
        self._to_device += data[: BUFFER - len(self._to_device)]

    def given(self) -> bytes:
        """To the host's end."""
        return _emptied(self._to_host)


def _emptied(buffer: bytearray) -> bytes:
    if not buffer:
        return b""
    data = bytes(buffer)
    buffer.clear()
    return data


def pump(link: Link, unit: SimulatedAurora, now: float) -> None:
    """Move bytes between the device's end of any link and the unit; without the link the unit goes on.

    Only a line in memory carries a break. `now` [s] is virtual or real, the same time that `advance` counts.
    """
    if isinstance(link, DeviceEnd) and link.broken:
        link.broken = False
        unit.restart(now)
    try:
        data = link.read()
        if not data and unit.due > now:
            unit.looked = now
            return
        host_baud: int | None = getattr(link, "host_baud", None)  # most links do not know it
        unit.receive(data, now, host_baud)
        data = unit.transmit(now, host_baud)
        if data:
            link.write(data)
    except LinkError:
        return
