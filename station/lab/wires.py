"""The wires of simulated devices: the devices' ends, and serial lines and networks in memory for virtual time."""

from collections import deque
from typing import NamedTuple, Protocol

from station.devices.aurora.protocol import POWER_UP_BAUD
from station.devices.links.link import Link, LinkError

BUFFER_BYTES = 4096  #: size of a serial port's buffer in each direction; further bytes are lost [bytes]
#: Largest number of datagrams that wait for reception; the oldest are lost.
MAX_PENDING_DATAGRAMS = 4096

Address = tuple[str, int]


class Plug(Protocol):
    """A plug that can be pulled."""

    def unplug(self) -> None:
        """Pull the plug."""
        ...

    def plug(self) -> None:
        """Insert the plug again."""
        ...


class DeviceLine(Link, Plug, Protocol):
    """The device's end of a serial line; if its cable is unplugged, the host's port disappears."""


class DatagramDeviceEnd(Protocol):
    """A simulated force-sensor box's end of a network: it receives requests and sends records."""

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the received datagrams with their senders."""
        ...

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one datagram, which may be lost."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


class HostPort:
    """The host's end of a serial line in memory. If its cable is unplugged, it fails until it is opened again."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.device = SerialDeviceEnd(name)
        self._open, self._pulls = True, 0

    def read(self) -> bytes:
        """Return the received bytes."""
        self._check()
        return _drain(self.device.to_host) if self.device.to_host else b""

    def write(self, data: bytes) -> None:
        """Send `data`."""
        self._check()
        _fill(self.device.to_device, data)

    def reopen(self) -> None:
        """Open the port again and discard all data in transit; raises LinkError while the cable is unplugged."""
        if not self.device.plugged:
            raise LinkError(f"{self.name} cannot be opened: it is not plugged in")
        self.device.to_host.clear()
        self.device.to_device.clear()
        self._open, self._pulls = True, self.device.pulls

    def set_baud(self, baud: int) -> None:
        """Set the baud rate [bit/s]."""
        self.device.host_baud = baud

    def set_break(self, low: bool) -> None:
        """Start or end a break, which resets an Aurora."""
        self.device.broken |= low

    def close(self) -> None:
        """Close the port; the simulated device continues to run."""
        self._open = False

    def _check(self) -> None:
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        if self._pulls != self.device.pulls:
            raise LinkError(f"{self.name} is gone: unplugged")


class SerialDeviceEnd:
    """The simulated device's end of a serial line in memory. It never fails; an unplugged cable loses all data."""

    def __init__(self, name: str) -> None:
        self.name = f"{name} (device)"
        self.host_baud = POWER_UP_BAUD
        self.broken = False  #: whether the host sent a break that the device has not processed yet
        self.plugged, self.pulls = True, 0  #: whether the cable is plugged in, and how often it was pulled
        self.to_device, self.to_host = bytearray(), bytearray()

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        return _drain(self.to_device) if self.to_device else b""

    def write(self, data: bytes) -> None:
        """Send `data` to the host."""
        if self.plugged:
            _fill(self.to_host, data)

    def unplug(self) -> None:
        """Pull the cable: the host's port disappears."""
        self.plugged, self.pulls = False, self.pulls + 1
        self.to_device.clear()

    def plug(self) -> None:
        """Plug the cable in again: the host may open its port again."""
        self.plugged = True

    def close(self) -> None:
        """Pull the cable permanently."""
        self.unplug()


def _fill(buffer: bytearray, data: bytes) -> None:
    buffer += data[: BUFFER_BYTES - len(buffer)]


def _drain(buffer: bytearray) -> bytes:
    data = bytes(buffer)
    buffer.clear()
    return data


class MemoryDatagramEnd:
    """A network in memory: a force-sensor box at one end, any number of hosts at the other."""

    def __init__(self) -> None:
        self._requests: deque[tuple[bytes, Address]] = deque(maxlen=MAX_PENDING_DATAGRAMS)
        self._hosts: dict[Address, deque[bytes]] = {}

    def link(self, name: str) -> "MemoryDatagrams":
        """Add a host to the network, and return its link."""
        address = (name, 50000 + len(self._hosts))
        self._hosts[address] = deque(maxlen=MAX_PENDING_DATAGRAMS)
        return MemoryDatagrams(name, address, self._hosts[address], self._requests)

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams that the hosts have sent."""
        if not self._requests:
            return []
        requests = list(self._requests)
        self._requests.clear()
        return requests

    def send(self, datagram: bytes, to: Address) -> None:
        """Send a datagram to a host; it is lost if the host does not exist."""
        if (host := self._hosts.get(to)) is not None:
            host.append(datagram)

    def close(self) -> None:
        """Remove the hosts."""
        self._hosts.clear()


class MemoryDatagrams:
    """A host's link to a force-sensor box in memory."""

    def __init__(
        self, name: str, address: Address, incoming: deque[bytes], outgoing: deque[tuple[bytes, Address]]
    ) -> None:
        self.name = name
        self.address = address
        self._incoming, self._outgoing = incoming, outgoing
        self._open = True

    def receive(self) -> list[bytes]:
        """Return the datagrams that the box has sent."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        if not self._incoming:
            return []
        datagrams = list(self._incoming)
        self._incoming.clear()
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Send a datagram to the box."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        self._outgoing.append((datagram, self.address))

    def close(self) -> None:
        """Close the link."""
        self._open = False


class MemoryInbox:
    """Receiver of the datagrams of simulated cameras in memory."""

    port = 0

    def __init__(self) -> None:
        self._waiting: deque[bytes] = deque(maxlen=MAX_PENDING_DATAGRAMS)

    def put(self, datagram: bytes) -> None:
        """Send a datagram to the receiver."""
        self._waiting.append(datagram)

    def receive(self) -> list[bytes]:
        """Return the datagrams that the cameras have sent."""
        datagrams = list(self._waiting)
        self._waiting.clear()
        return datagrams

    def close(self) -> None:
        """Discard the datagrams."""
        self._waiting.clear()


class Wires(NamedTuple):
    """The simulated devices' ends of the wires."""

    stages: DeviceLine
    aurora: DeviceLine
    netft: tuple[DatagramDeviceEnd, ...]  #: ends of the force sensors


class Hosts(NamedTuple):
    """The station drivers' ends of wires in memory."""

    stages: HostPort
    aurora: HostPort
    netft: tuple[MemoryDatagrams, ...]
    cameras: MemoryInbox


def memory_wires(sensors: int, stages: str = "zaber") -> tuple[Wires, Hosts]:
    """Return wires in memory, for virtual time; `stages` is the name of the stages' line."""
    line, aurora = HostPort(stages), HostPort("aurora")
    ends = tuple(MemoryDatagramEnd() for _ in range(sensors))
    links = tuple(end.link(f"netft {number}") for number, end in enumerate(ends, 1))
    return Wires(line.device, aurora.device, ends), Hosts(line, aurora, links, MemoryInbox())
