"""Links that carry a device's bytes: serial ports and sockets, datagrams, and pipes in memory.

A link is looked at, never waited for. What a device makes of the bytes is its protocol's business.
"""

import contextlib
import errno
import socket
import time
from collections import deque
from typing import Any, Protocol, cast

import serial

from core.errors import CtrError

BREAK = 0.25  #: that a serial line is held low [s]


class LinkError(CtrError):
    """A link that cannot be opened or that has gone; names the link and what to do."""


class Link(Protocol):
    """Bytes to and from a device."""

    name: str  #: for messages

    def read(self) -> bytes:
        """What has arrived since the last read, without waiting.

        Raises:
            LinkError: the other end is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send `data` without waiting.

        Raises:
            LinkError: the other end is gone or takes nothing.
        """
        ...

    def close(self) -> None:
        """Let go of the port."""
        ...


class MemoryLink:
    """One end of a pipe in memory, for virtual time."""

    def __init__(self, name: str, incoming: deque[bytes], outgoing: deque[bytes]) -> None:
        self.name = name
        self._incoming, self._outgoing = incoming, outgoing
        self._open = True

    def read(self) -> bytes:
        """What the other end has written."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        if not self._incoming:
            return b""
        data = b"".join(self._incoming)
        self._incoming.clear()
        return data

    def write(self, data: bytes) -> None:
        """Give `data` to the other end."""
        if not self._open:
            raise LinkError(f"{self.name} is closed")
        if data:
            self._outgoing.append(data)

    def close(self) -> None:
        """Take part no more."""
        self._open = False


def memory_pipe(name: str) -> tuple[MemoryLink, MemoryLink]:
    """Two ends of a pipe: the host's and the device's."""
    to_device: deque[bytes] = deque()
    to_host: deque[bytes] = deque()
    return MemoryLink(name, to_host, to_device), MemoryLink(f"{name} (device)", to_device, to_host)


class SerialLink:
    """A serial port or whatever pyserial opens by URL: /dev/ttyUSB0, COM3, a pty, socket://host:port."""

    def __init__(self, url: str, baud: int) -> None:
        """Raises LinkError when it cannot be opened or another program has it."""
        self.name = url
        try:
            self._port = cast(Any, serial).serial_for_url(
                url, baudrate=baud, timeout=0.0, write_timeout=0.0, **({} if "://" in url else {"exclusive": True})
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(f"{url} cannot be opened: {error}; is it plugged in, and free?") from None

    def read(self) -> bytes:
        """What the port has."""
        try:
            return bytes(self._port.read(65536))
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkError(f"{self.name} is gone: {error}") from None

    def write(self, data: bytes) -> None:
        """Put `data` into the port."""
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise LinkError(f"{self.name} takes nothing: {error}") from None

    def set_baud(self, baud: int) -> None:
        """Change the rate of both directions [bit/s]."""
        try:
            self._port.baudrate = baud
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(f"{self.name} cannot run at {baud} baud: {error}") from None

    def send_break(self) -> None:
        """Hold the line low; waits for the 0.25 s that it takes: for connecting only, never for the loop.

        A pty and a socket carry no break: nothing but the wait happens.
        """
        # Not the port's own send_break: on Linux it makes 0.1 s of the 0.25 s that it is asked for.
        with contextlib.suppress(serial.SerialException, OSError, NotImplementedError):
            self._port.break_condition = True
            time.sleep(BREAK)
            self._port.break_condition = False

    def close(self) -> None:
        """Let go of the port."""
        # pyserial forgets the socket of a socket:// port whose peer has left first.
        inner = getattr(self._port, "_socket", None)
        self._port.close()
        if isinstance(inner, socket.socket):
            inner.close()


class DatagramLink:
    """Datagrams to and from one UDP peer."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError when the address means nothing."""
        self.name = f"udp://{host}:{port}"
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            self._socket.connect(address)
        except OSError as error:
            raise LinkError(f"{self.name} cannot be reached: {error}") from None

    def receive(self) -> list[bytes]:
        """Whole datagrams that have arrived."""
        datagrams: list[bytes] = []
        while True:
            try:
                datagrams.append(self._socket.recv(65536))
            except BlockingIOError:
                return datagrams
            except ConnectionRefusedError:
                return datagrams  # nobody listens (yet); silence is noticed by the driver's deadline
            except OSError as error:
                raise LinkError(f"{self.name} is gone: {error}") from None

    def send(self, datagram: bytes) -> None:
        """Send one datagram; a full buffer or an absent peer loses it, as a network would."""
        try:
            self._socket.send(datagram)
        except (BlockingIOError, ConnectionRefusedError):
            return
        except OSError as error:
            if error.errno not in (errno.ENETUNREACH, errno.EHOSTUNREACH):
                raise LinkError(f"{self.name} is gone: {error}") from None

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
