"""A pipe in memory that replaces a serial line in virtual time, with a cable that can be unplugged."""

from collections import deque

from station.devices.links.link import LinkError

MAX_PENDING_WRITES = 4096  #: largest number of unread writes in each direction; the oldest are discarded


class Cable:
    """Connection of two ends in memory. After it was unplugged, the host's port fails until the host opens it again."""

    def __init__(self) -> None:
        self.plugged = True
        self.pulls = 0

    def unplug(self) -> None:
        """Pull the plug."""
        self.plugged = False
        self.pulls += 1

    def plug(self) -> None:
        """Plug the cable in again."""
        self.plugged = True


class MemoryLink:
    """The host's end of a pipe in memory, for virtual time."""

    def __init__(self, name: str, incoming: deque[bytes], outgoing: deque[bytes], cable: Cable) -> None:
        self.name = name
        self._incoming, self._outgoing, self._cable = incoming, outgoing, cable
        self._open, self._pulls = True, 0

    def read(self) -> bytes:
        """Return the bytes that the other end has written."""
        if not self._open or self._pulls != self._cable.pulls:
            raise LinkError(self._gone())
        if not self._incoming:
            return b""
        data = b"".join(self._incoming)
        self._incoming.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send `data` to the other end."""
        if not self._open or self._pulls != self._cable.pulls:
            raise LinkError(self._gone())
        if data:
            self._outgoing.append(data)

    def reopen(self) -> None:
        """Open the port again and discard all data in transit; raises LinkError while the cable is unplugged."""
        if not self._cable.plugged:
            raise LinkError(f"{self.name} cannot be opened: it is not plugged in")
        self._incoming.clear()
        self._outgoing.clear()
        self._open, self._pulls = True, self._cable.pulls

    def close(self) -> None:
        """Close the host's end."""
        self._open = False

    def _gone(self) -> str:
        return f"{self.name} is gone: unplugged" if self._open else f"{self.name} is closed"


class MemoryEnd:
    """The device's end of a pipe in memory. It never fails; while the cable is unplugged all data are lost."""

    def __init__(self, name: str, incoming: deque[bytes], outgoing: deque[bytes], cable: Cable) -> None:
        self.name = name
        self._incoming, self._outgoing, self._cable = incoming, outgoing, cable

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        if not self._incoming:
            return b""
        data = b"".join(self._incoming) if self._cable.plugged else b""
        self._incoming.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send `data` to the host."""
        if data and self._cable.plugged:
            self._outgoing.append(data)

    def unplug(self) -> None:
        """Pull the cable: the host's port is gone."""
        self._cable.unplug()

    def plug(self) -> None:
        """Plug the cable in again: the host can open its port again."""
        self._cable.plug()

    def close(self) -> None:
        """Unplug the cable permanently."""
        self._cable.unplug()


def memory_pipe(name: str) -> tuple[MemoryLink, MemoryEnd]:
    """Return two ends of a pipe: the host's and the device's."""
    to_device: deque[bytes] = deque(maxlen=MAX_PENDING_WRITES)
    to_host: deque[bytes] = deque(maxlen=MAX_PENDING_WRITES)
    cable = Cable()
    host = MemoryLink(name, to_host, to_device, cable)
    return host, MemoryEnd(f"{name} (device)", to_device, to_host, cable)
