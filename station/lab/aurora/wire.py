"""The serial line of a simulated Aurora tracker: a pipe in memory with baud rate and break.

`pump` carries bytes between the simulated tracker and any kind of link.
"""

from station.devices.aurora.protocol import POWER_UP_BAUD
from station.devices.links.link import Link, LinkError
from station.devices.links.memory_pipe import Cable
from station.lab.aurora.simulated import SimulatedAurora

BUFFER_BYTES = 4096  #: size of a port's buffer in each direction; further bytes are lost [bytes]


class HostPort:
    """The host's end of a line in memory; in contrast to a plain pipe it has a baud rate and a break."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.device = SerialDeviceEnd(name)
        self._pulls = 0

    def read(self) -> bytes:
        """Return the received bytes."""
        self._check()
        return self.device.take_output()

    def write(self, data: bytes) -> None:
        """Send `data`."""
        self._check()
        self.device.accept_input(data)

    def reopen(self) -> None:
        """Open the port again; raises LinkError while the cable is unplugged."""
        if not self.device.cable.plugged:
            raise LinkError(f"{self.name} cannot be opened: it is not plugged in")
        self.device.take_output()
        self._pulls = self.device.cable.pulls

    def set_baud(self, baud: int) -> None:
        """Set the baud rate [bit/s]."""
        self.device.host_baud = baud

    def set_break(self, low: bool) -> None:
        """Start or end a break, which resets the tracker."""
        self.device.broken |= low

    def close(self) -> None:
        """Close the host's port; the simulated tracker continues to run."""

    def _check(self) -> None:
        if self._pulls != self.device.cable.pulls:
            raise LinkError(f"{self.name} is gone: unplugged")


class SerialDeviceEnd:
    """The simulated tracker's end of a line in memory."""

    def __init__(self, name: str) -> None:
        self.name = f"{name} (device)"
        self.host_baud = POWER_UP_BAUD
        self.broken = False  #: whether the host sent a break that the tracker has not processed yet
        self.cable = Cable()
        self._to_device, self._to_host = bytearray(), bytearray()

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        return _drain(self._to_device)

    def write(self, data: bytes) -> None:
        """Send `data` to the host."""
        if self.cable.plugged:
            self._to_host += data[: BUFFER_BYTES - len(self._to_host)]

    def unplug(self) -> None:
        """Pull the cable: the host's port disappears."""
        self.cable.unplug()
        self._to_device.clear()

    def plug(self) -> None:
        """Plug the cable in again: the host may open its port again."""
        self.cable.plug()

    def close(self) -> None:
        """Pull the cable for good."""
        self.unplug()

    def accept_input(self, data: bytes) -> None:
        """Accept bytes from the host's end."""
        self._to_device += data[: BUFFER_BYTES - len(self._to_device)]

    def take_output(self) -> bytes:
        """Return the bytes for the host's end."""
        return _drain(self._to_host)


def _drain(buffer: bytearray) -> bytes:
    if not buffer:
        return b""
    data = bytes(buffer)
    buffer.clear()
    return data


def pump(link: Link, unit: SimulatedAurora, now: float) -> None:
    """Transmit bytes between the device's end of any link and the tracker; if the link fails the tracker continues.

    Only a line in memory transmits a break. `now` [s] is virtual or real time, the same as that of `advance`.
    """
    if isinstance(link, SerialDeviceEnd) and link.broken:
        link.broken = False
        unit.restart(now)
    try:
        data = link.read()
        if not data and unit.due > now:
            unit.last_poll = now
            return
        host_baud: int | None = getattr(link, "host_baud", None)  # most links do not have it
        unit.receive(data, now, host_baud)
        data = unit.transmit(now, host_baud)
        if data:
            link.write(data)
    except LinkError:
        return
