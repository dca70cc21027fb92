"""The network connections of the simulated Net F/T box: datagrams by UDP or in memory, and its page by HTTP.

All connections are polled without threads. In memory, queues store the datagrams for virtual time.
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
#: Limits of the box's page server: size of a request [bytes], number of simultaneous connections, and number of polls
#: after which a slow request is cut off.
MAX_REQUEST_BYTES, MAX_CONNECTIONS, MAX_REQUEST_POLLS = 8192, 16, 2000
#: Largest number of datagrams read at one poll, because a flood of requests must not delay the box's records.
MAX_DATAGRAMS = 64
#: Largest number of datagrams that wait for reception; the oldest are lost.
MAX_PENDING_DATAGRAMS = 4096


class AddressInUse(CtrError):
    """An address or port is not available to a simulated device."""


class DatagramDeviceEnd(Protocol):
    """The box's end of a network: it receives requests and sends records."""

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the received datagrams with their senders."""
        ...

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one datagram, which may be lost."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


class MemoryDatagramEnd:
    """A network in memory: the box at one end, any number of hosts at the other."""

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
    """A host's link to the box in memory."""

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


class UdpDeviceEnd:
    """The box's port on a network."""

    def __init__(self, host: str, port: int) -> None:
        """Open the port; port 0 selects any free port. Raises AddressInUse."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise AddressInUse(f"udp://{host}:{port} is not available: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the received datagrams; errors of hosts that have gone are ignored."""
        found: list[tuple[bytes, Address]] = []
        for _ in range(MAX_DATAGRAMS):
            try:
                found.append(self._socket.recvfrom(65536))
            except BlockingIOError:
                break
            except OSError:
                continue
        return found

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one datagram; it is lost if the buffer is full or the host absent."""
        with contextlib.suppress(OSError):
            self._socket.sendto(datagram, to)

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


class _PageRequest(NamedTuple):
    """A connection to the page server: received request, remaining answer, and number of polls."""

    socket: socket.socket
    received: bytearray
    answer: bytearray
    polls: list[int]


class PageServer:
    """An HTTP server for one page, with the necessary subset of HTTP."""

    def __init__(self, host: str, port: int, page: Callable[[], bytes | None]) -> None:
        """Open the port; port 0 selects any free port. Raises AddressInUse.

        `page` is called for each request; the server does not answer if it returns None.
        """
        self._page = page
        self._connections: list[_PageRequest] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
            self._socket.listen(MAX_CONNECTIONS)
        except OSError as error:
            self._socket.close()
            raise AddressInUse(f"http://{host}:{port} is not available: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]

    def poll(self) -> None:
        """Serve the present connections without waiting."""
        with contextlib.suppress(OSError):
            while len(self._connections) < MAX_CONNECTIONS:
                connection, _ = self._socket.accept()
                connection.setblocking(False)
                self._connections.append(_PageRequest(connection, bytearray(), bytearray(), [0]))
        if self._connections:
            self._connections = [connection for connection in self._connections if self._serve(connection)]

    def close(self) -> None:
        """Close the port and all connections."""
        for connection in self._connections:
            connection.socket.close()
        self._connections.clear()
        self._socket.close()

    def _serve(self, connection: _PageRequest) -> bool:
        """Continue with a connection; return False when it is finished."""
        connection.polls[0] += 1
        active = connection.polls[0] < MAX_REQUEST_POLLS
        try:
            if not connection.answer:
                data = connection.socket.recv(MAX_REQUEST_BYTES)
                connection.received.extend(data)
                if answer := respond(bytes(connection.received), self._page):
                    connection.answer.extend(answer)
                elif not data:
                    active = False
            if connection.answer:
                del connection.answer[: connection.socket.send(connection.answer)]
                active = active and bool(connection.answer)
        except BlockingIOError:
            pass
        except OSError:
            active = False
        if not active:
            connection.socket.close()
        return active


def respond(request: bytes, page: Callable[[], bytes | None]) -> bytes:
    """Return the page server's answer to a request; b"" if the request is incomplete or the box is mute."""
    head, complete, _ = request.partition(b"\r\n\r\n")
    if not complete:
        return _answer(b"431 Request Header Fields Too Large", b"") if len(request) >= MAX_REQUEST_BYTES else b""
    line = _REQUEST_LINE.fullmatch(head.split(b"\r\n", 1)[0])
    if line is None:
        return _answer(b"400 Bad Request", b"")
    method, path = line.groups()
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
