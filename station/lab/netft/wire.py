"""The simulated Net F/T's ends of the wire: datagrams by UDP or in memory, and its page by HTTP.

All of it is polled; there is no thread. In memory the datagrams wait in queues, for virtual time.
"""

import contextlib
import re
import socket
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from core.errors import CtrError
from station.devices.links.link import LinkError

Address = tuple[str, int]

_REQUEST_LINE = re.compile(rb"([A-Z]+) ([!->@-~]+)(?:\?[!-~]*)? HTTP/1\.[01]")
#: A request longer than this, or one of more visitors at once than this, is cut off; so is a slow one.
LONGEST_REQUEST, MOST_VISITORS, PATIENCE = 8192, 16, 2000
#: Datagrams that wait to be received; the oldest get lost.
MOST_WAITING = 4096


class AddressTaken(CtrError):
    """An address that the simulated box cannot have."""


class DeviceEnd(Protocol):
    """Where the box hears requests and sends records."""

    def receive(self) -> list[tuple[bytes, Address]]:
        """Datagrams that have arrived, and from whom."""
        ...

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one datagram, which may get lost."""
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class MemoryEnd:
    """A network in memory: the box at one end, any number of hosts at the other."""

    def __init__(self) -> None:
        self._requests: deque[tuple[bytes, Address]] = deque(maxlen=MOST_WAITING)
        self._hosts: dict[Address, deque[bytes]] = {}

    def link(self, name: str) -> "MemoryDatagrams":
        """Another host on the network."""
        address = (name, 50000 + len(self._hosts))
        self._hosts[address] = deque(maxlen=MOST_WAITING)
        return MemoryDatagrams(name, address, self._hosts[address], self._requests)

    def receive(self) -> list[tuple[bytes, Address]]:
        """What the hosts have sent."""
        if not self._requests:
            return []
        requests = list(self._requests)
        self._requests.clear()
        return requests

    def send(self, datagram: bytes, to: Address) -> None:
        """Give a datagram to a host; one that is not there loses it."""
        if (host := self._hosts.get(to)) is not None:
            host.append(datagram)

    def close(self) -> None:
        """Forget the hosts."""
        self._hosts.clear()


class MemoryDatagrams:
    """A host's link to the box in memory."""

    def __init__(
        self, name: str, address: Address, incoming: deque[bytes], outgoing: deque[tuple[bytes, Address]]
    ) -> None:
        self.name = name
        self.address = address
        self._incoming, self._outgoing = incoming, outgoing
        self._open = True

    def receive(self) -> list[bytes]:
        """What the box has sent."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        if not self._incoming:
            return []
        datagrams = list(self._incoming)
        self._incoming.clear()
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Give a datagram to the box."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        self._outgoing.append((datagram, self.address))

    def close(self) -> None:
        """Take part no more."""
        self._open = False


class UdpEnd:
    """The box's port on a network."""

    def __init__(self, host: str, port: int) -> None:
        """Port 0 takes any that is free; raises AddressTaken."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise AddressTaken(f"udp://{host}:{port} cannot be had: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]

    def receive(self) -> list[tuple[bytes, Address]]:
        """What has arrived; a host that has gone is no news."""
        found: list[tuple[bytes, Address]] = []
        while len(found) < 1000:
            try:
                found.append(self._socket.recvfrom(65536))
            except BlockingIOError:
                break
            except OSError:
                continue
        return found

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one; a full buffer or an absent host loses it."""
        with contextlib.suppress(OSError):
            self._socket.sendto(datagram, to)

    def close(self) -> None:
        """Let go of the port."""
        self._socket.close()


class _Visitor(NamedTuple):
    """A connection: what was heard, what is still to be said, and how long it may take."""

    socket: socket.socket
    heard: bytearray
    answer: bytearray
    polls: list[int]


class PageServer:
    """Just enough of HTTP to be asked for one page."""

    def __init__(self, host: str, port: int, page: Callable[[], bytes | None]) -> None:
        """`page` is made anew for each visitor; None keeps silent. Port 0 takes any; raises AddressTaken."""
        self._page = page
        self._visitors: list[_Visitor] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
            self._socket.listen(MOST_VISITORS)
        except OSError as error:
            self._socket.close()
            raise AddressTaken(f"http://{host}:{port} cannot be had: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]

    def poll(self) -> None:
        """Serve whoever is there, without waiting."""
        with contextlib.suppress(OSError):
            while len(self._visitors) < MOST_VISITORS:
                visitor, _ = self._socket.accept()
                visitor.setblocking(False)
                self._visitors.append(_Visitor(visitor, bytearray(), bytearray(), [0]))
        if self._visitors:
            self._visitors = [visitor for visitor in self._visitors if self._serve(visitor)]

    def close(self) -> None:
        """Let go of the port and of everybody."""
        for visitor in self._visitors:
            visitor.socket.close()
        self._visitors.clear()
        self._socket.close()

    def _serve(self, visitor: _Visitor) -> bool:
        """Go on with a visitor; False when done with."""
        visitor.polls[0] += 1
        stays = visitor.polls[0] < PATIENCE
        try:
            if not visitor.answer:
                data = visitor.socket.recv(LONGEST_REQUEST)
                visitor.heard.extend(data)
                if answer := respond(bytes(visitor.heard), self._page):
                    visitor.answer.extend(answer)
                elif not data:
                    stays = False
            if visitor.answer:
                del visitor.answer[: visitor.socket.send(visitor.answer)]
                stays = stays and bool(visitor.answer)
        except BlockingIOError:
            pass
        except OSError:
            stays = False
        if not stays:
            visitor.socket.close()
        return stays


def respond(heard: bytes, page: Callable[[], bytes | None]) -> bytes:
    """The answer to a request; b"" while it is not complete, or if the box keeps silent."""
    head, complete, _ = heard.partition(b"\r\n\r\n")
    if not complete:
        return _answer(b"431 Request Header Fields Too Large", b"") if len(heard) >= LONGEST_REQUEST else b""
    asked = _REQUEST_LINE.fullmatch(head.split(b"\r\n", 1)[0])
    if asked is None:
        return _answer(b"400 Bad Request", b"")
    method, path = asked.groups()
    if method not in (b"GET", b"HEAD"):
        return _answer(b"405 Method Not Allowed", b"")
    if path != b"/netftapi2.xml":
        return _answer(b"404 Not Found", b"")
    body = page()
    if body is None:
        return b""
    answer = _answer(b"200 OK", body)
    return answer if method == b"GET" else answer[: len(answer) - len(body)]


def _answer(status: bytes, body: bytes) -> bytes:
    lines = [
        b"HTTP/1.1 " + status,
        b"Content-Type: text/xml",
        b"Content-Length: %d" % len(body),
        b"Connection: close",
    ]
    return b"\r\n".join(lines) + b"\r\n\r\n" + body
