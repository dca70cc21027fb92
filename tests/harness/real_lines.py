"""Pseudo-terminals and TCP sockets of the operating system, with both ends in one thread.

Each end waits for the bytes that the other end has written. The system may take any time to transfer them, because the
test's virtual time does not advance meanwhile.
"""

import os
import select
import socket
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from station.devices.links.link import SerialLink

RATES = {termios.B9600: 9600, termios.B115200: 115200}


class FileLink:
    """The device's end of a pseudo-terminal or of a connected socket."""

    name = "device"

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)

    @property
    def host_baud(self) -> int | None:
        """Baud rate that the host has set [bit/s]; None if the line has none."""
        return RATES.get(termios.tcgetattr(self._descriptor)[4]) if os.isatty(self._descriptor) else None

    def read(self) -> bytes:
        try:
            return os.read(self._descriptor, 4096)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        os.write(self._descriptor, data)


class End:
    """One end of a line: a link and its file descriptor."""

    def __init__(self, link: Any, file: int) -> None:
        self._link, self._file = link, file
        self._coming = 0  #: number of bytes that the other end has written and this end has not read
        self.other: End

    def read(self) -> bytes:
        data = b""
        while self._coming > 0:
            select.select([self._file], [], [])
            part = self._link.read()
            self._coming -= len(part)
            data += part
        return data

    def write(self, data: bytes) -> None:
        self._link.write(data)
        self.other._coming += len(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)


@contextmanager
def pty_line() -> Iterator[tuple[End, End]]:
    """Yield the host's and the device's end of a pseudo-terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    link = SerialLink(os.ttyname(slave), 9600)
    try:
        yield _joined(link, master)
    finally:
        link.close()
        os.close(master)
        os.close(slave)


@contextmanager
def socket_line() -> Iterator[tuple[End, End]]:
    """Yield the host's and the device's end of a TCP connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 9600)
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # otherwise TCP delays and joins the replies
    with connection:
        try:
            yield _joined(link, connection.fileno())
        finally:
            link.close()


def _joined(link: SerialLink, descriptor: int) -> tuple[End, End]:
    near, far = End(link, link._port.fileno()), End(FileLink(descriptor), descriptor)
    near.other, far.other = far, near
    return near, far
