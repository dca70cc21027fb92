"""Links that carry a device's bytes: serial ports, sockets and datagrams.

A link is looked at, never waited for. What a device makes of the bytes is its protocol's business. A link
has its device for itself, and one that has gone can be opened anew.
"""

import contextlib
import errno
import socket
from typing import Any, Protocol, cast

import serial

from core.errors import CtrError
from station.devices.links.port_lock import PortLock, PortTaken
from station.devices.links.rediscover import describe, find, usb_ports


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


def reopen(link: Link) -> Link:
    """Open a link anew whose other end had gone: the same device, under whatever name its port has now.

    Raises:
        LinkError: it is not there, or the link is of a kind that cannot come back.
    """
    again = getattr(link, "reopen", None)
    if again is None:
        raise LinkError(f"{link.name} cannot be opened anew; start the station again")
    again()
    return link


class SerialLink:
    """A serial port or whatever pyserial opens by URL: /dev/ttyUSB0, COM3, a pty, socket://host:port."""

    def __init__(self, url: str, baud: int) -> None:
        """Raises LinkError when it cannot be opened or another program has it."""
        self.name, self._baud = url, baud
        self._lock, self._port = _open(url, baud)
        #: By which it is found again, if it is on USB.
        self._adapter = None if "://" in url else describe(url, usb_ports())

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

    def set_break(self, low: bool) -> None:
        """Hold the line low, or let it go again: a break lasts for as long as the caller says.

        A pty and a socket carry no break: nothing happens.
        """
        with contextlib.suppress(serial.SerialException, OSError, NotImplementedError):
            self._port.break_condition = low

    def reopen(self) -> None:
        """Open it anew at its first rate: the same USB adapter, whatever its port is called now.

        Raises:
            LinkError: it is not plugged in, or another program has it.
        """
        self.close()
        url = self.name
        if self._adapter is not None:
            url = find(self._adapter, usb_ports())
            if url is None:
                raise LinkError(f"{self.name} is gone and {self._adapter} is not found again; is it plugged in?")
        self._lock, self._port = _open(url, self._baud)
        self.name = url

    def close(self) -> None:
        """Let go of the port."""
        # pyserial forgets the socket of a socket:// port whose peer has left first.
        inner = _socket_of(self._port)
        self._port.close()
        if inner is not None:
            inner.close()
        self._lock.release()


def _socket_of(port: Any) -> socket.socket | None:
    """What is behind a socket:// port of pyserial."""
    inner = getattr(port, "_socket", None)
    return inner if isinstance(inner, socket.socket) else None


def _open(url: str, baud: int) -> tuple[PortLock, Any]:
    """A port and the right to it."""
    try:
        lock = PortLock(url)
    except PortTaken as error:
        raise LinkError(str(error)) from None
    try:
        port = cast(Any, serial).serial_for_url(
            url, baudrate=baud, timeout=0.0, write_timeout=0.0, **({} if "://" in url else {"exclusive": True})
        )
        inner = _socket_of(port)
        if inner is not None:
            # Or a message waits up to 40 ms for the other side to have confirmed the one before it.
            inner.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return lock, port
    except (serial.SerialException, OSError, ValueError) as error:
        lock.release()
        raise LinkError(f"{url} cannot be opened: {error}; is it plugged in, and free?") from None


class DatagramLink:
    """Datagrams to and from one UDP peer."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError when the address means nothing or another link has it."""
        self.name = f"udp://{host}:{port}"
        try:
            self._lock = PortLock(self.name)
        except PortTaken as error:
            raise LinkError(str(error)) from None
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            self._socket.connect(address)
        except OSError as error:
            self._lock.release()
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
        self._lock.release()
