"""The endpoints of simulated devices: serial lines by TCP or pseudo-terminal, datagrams by UDP, and a page by HTTP.

All of them are polled without threads.
"""

import contextlib
import os
import re
import select
import socket
import sys
from collections.abc import Callable, Container, Iterable
from pathlib import Path
from typing import NamedTuple

from core.errors import CtrError
from station.lab.wires import Address

if sys.platform != "win32":
    import fcntl
    import termios
    import tty


HOST = "127.0.0.1"
#: Largest number of bytes read from a line at one poll, which is the size of a serial port's buffer. Further bytes wait
#: in the operating system's buffers.
MAX_READ_BYTES = 4096
#: Largest number of connections accepted at one poll, because a flood of connections must not delay the devices.
MAX_VISITORS = 16
_REQUEST_LINE = re.compile(rb"([A-Z]+) ([!->@-~]+)(?:\?[!-~]*)? HTTP/1\.[01]")
#: Limits of the page server of a force-sensor box: size of a request [bytes], number of simultaneous connections, and
#: number of polls after which a slow request is cut off.
MAX_REQUEST_BYTES, MAX_CONNECTIONS, MAX_REQUEST_POLLS = 8192, 16, 2000
#: Largest number of datagrams read at one poll, because a flood of requests must not delay a force sensor's records.
MAX_DATAGRAMS = 64


class AddressInUse(CtrError):
    """An address or port is not available to a simulated device."""


class Readable:
    """The file descriptors with unread data, found by one system call, so that endpoints read only if there are data.

    Before the first `wait` every file counts as readable.
    """

    def __init__(self) -> None:
        self._found: Container[int] | None = None

    def wait(self, files: Iterable[int], timeout: float) -> None:
        """Wait until one of the file descriptors has unread data, or for `timeout` [s]."""
        self._found = select.select(list(files), [], [], timeout)[0]

    def __contains__(self, file: int) -> bool:
        return self._found is None or file in self._found


class TcpDeviceEnd:
    """The device's end of a serial line by TCP. Like a serial port it serves one program at a time."""

    def __init__(self, readable: Readable | None = None) -> None:
        self._readable = readable or Readable()
        self._server = socket.create_server((HOST, 0))
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self._port: int = self._server.getsockname()[1]
        self.name = f"socket://{HOST}:{self._port}"

    @property
    def files(self) -> list[int]:
        """Return the file descriptors whose data the server waits for."""
        return [file for file in (self._server.fileno(), self._host.fileno() if self._host else -1) if file >= 0]

    def read(self) -> bytes:
        """Return the bytes that the host has written; empty without a host."""
        data = b""
        arrived = self._host is not None and self._host.fileno() in self._readable
        while arrived and self._host is not None:
            try:
                part = self._host.recv(MAX_READ_BYTES - len(data))
            except BlockingIOError:
                break
            except OSError:
                part = b""
            if not part:
                self._host.close()
                self._host = None
            data += part
            if len(data) >= MAX_READ_BYTES:
                return data  # read the remaining bytes at the next poll, and accept the next host only then
        if self._server.fileno() in self._readable:
            self._admit()
        return data

    def write(self, data: bytes) -> None:
        """Send `data` to the host; it is lost without a host, or if the host does not read."""
        if self._host is not None:
            with contextlib.suppress(OSError):
                self._host.send(data)

    def unplug(self) -> None:
        """Pull the cable: the host is disconnected, and new connections are refused."""
        self.close()

    def plug(self) -> None:
        """Plug the cable in again; raises AddressInUse if another program has taken the port."""
        try:
            self._server = socket.create_server((HOST, self._port))
        except OSError as error:
            raise AddressInUse(f"{self.name} is not available again: {error.strerror}") from None
        self._server.setblocking(False)

    def close(self) -> None:
        """Close the port and the connection."""
        if self._host is not None:
            self._host.close()
            self._host = None
        self._server.close()

    def _admit(self) -> None:
        """Accept the connection of the next host; close it if another host is connected already."""
        with contextlib.suppress(OSError):
            for _ in range(MAX_VISITORS):
                visitor, _ = self._server.accept()
                if self._host is not None:
                    visitor.close()
                    continue
                visitor.setblocking(False)
                visitor.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # send each reply at once
                self._host = visitor


class PtyDeviceEnd:
    """The device's end of a serial line by pseudo-terminal.

    A kernel thread of normal priority carries the bytes. `select` and a read of an empty terminal wait for that thread,
    for tens of milliseconds on a busy computer. So the lab only queries how many bytes have arrived.
    """

    def __init__(self, link: Path | None = None) -> None:
        """`link` is a symbolic link to the terminal, which stays valid when the terminal changes."""
        self._link = link
        self._files: list[int] = []
        self.plug()
        self.name = str(link or os.ttyname(self._files[1]))

    @property
    def files(self) -> list[int]:
        """Return no file descriptors to wait for, because the terminal is polled."""
        return []

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        if not self._files:
            return b""
        arrived = int.from_bytes(fcntl.ioctl(self._files[0], termios.FIONREAD, bytes(4)), sys.byteorder)
        return os.read(self._files[0], MAX_READ_BYTES) if arrived else b""

    def write(self, data: bytes) -> None:
        """Send `data` to the host; bytes beyond the terminal's buffer are lost."""
        with contextlib.suppress(BlockingIOError):
            if self._files:
                os.write(self._files[0], data)

    def unplug(self) -> None:
        """Pull the cable: the host's terminal disappears."""
        self.close()

    def plug(self) -> None:
        """Plug the cable in again: open a new terminal. Its name may change, like that of a real USB adapter."""
        # Keep the host's side open, because the line would hang up when a host closes it.
        self._files = list(os.openpty())
        tty.setraw(self._files[1])
        os.set_blocking(self._files[0], False)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._files[1]))

    def close(self) -> None:
        """Close the terminal."""
        while self._files:
            os.close(self._files.pop())


class UdpDeviceEnd:
    """The UDP port of a simulated force-sensor box."""

    def __init__(self, host: str, port: int, readable: Readable | None = None) -> None:
        """Open the port; port 0 selects any free port. Raises AddressInUse."""
        self._readable = readable or Readable()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise AddressInUse(f"udp://{host}:{port} is not available: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]

    @property
    def files(self) -> list[int]:
        """Return the file descriptor whose data the server waits for."""
        return [self._socket.fileno()]

    def receive(self) -> list[tuple[bytes, Address]]:
        """Return the received datagrams; errors because a host has closed its port are ignored."""
        found: list[tuple[bytes, Address]] = []
        if self._socket.fileno() not in self._readable:
            return found
        for _ in range(MAX_DATAGRAMS):
            try:
                found.append(self._socket.recvfrom(65536))
            except BlockingIOError:
                break
            except OSError:
                continue
        return found

    def send(self, datagram: bytes, to: Address) -> None:
        """Send one datagram; it is lost if the buffer is full or the host does not exist."""
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

    def __init__(
        self, host: str, port: int, page: Callable[[], bytes | None], readable: Readable | None = None
    ) -> None:
        """Open the port; port 0 selects any free port. Raises AddressInUse.

        `page` is called for each request; the server does not answer if it returns None.
        """
        self._page, self._readable = page, readable or Readable()
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

    @property
    def files(self) -> list[int]:
        """Return the file descriptor whose connections the server waits for."""
        return [self._socket.fileno()]

    def poll(self) -> None:
        """Serve the present connections without waiting."""
        if self._socket.fileno() in self._readable:
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
        """Serve a connection without waiting; return False when it is finished."""
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
    """Return the page server's answer to a request; b"" if the request is incomplete or `page` returns None."""
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
    lines = [b"HTTP/1.1 " + status, b"Content-Type: text/xml", b"Content-Length: %d" % len(body), b"Connection: close"]
    return b"\r\n".join(lines) + b"\r\n\r\n" + body
