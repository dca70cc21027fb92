"""Links that carry a device's bytes: serial ports, sockets and datagrams.

A driver polls its link and never waits for data. The device's protocol interprets the bytes. A link has exclusive
access to its device. A link whose device was lost can be opened again.
"""

import contextlib
import errno
import os
import socket
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast
from urllib.parse import quote, urlsplit

import serial
from serial.tools import list_ports

from core.errors import CtrError

if sys.platform != "win32":
    import fcntl

#: Largest number of datagrams read at one call, so that a flood cannot delay the caller.
MAX_INBOX_DATAGRAMS = 64


class LinkError(CtrError):
    """A link cannot be opened or has been lost; the text names the link and what to do."""


class PortInUse(LinkError):
    """A station, this one or another one, uses the device already; the text names the device and the process."""


def device_name(url: str) -> str:
    """Return a unique name of the device: its file with symbolic links resolved, or its URL with the host's address."""
    if "://" not in url:
        return os.path.realpath(url)
    parts = urlsplit(url)
    host = parts.hostname or ""
    try:
        host = str(socket.getaddrinfo(host, parts.port)[0][4][0])
    except (OSError, ValueError):
        return url  # the host is unknown, so the device cannot be opened either, or the URL has no host
    return f"{parts.scheme}://{host}:{parts.port}"


def lock_file(url: str) -> Path:
    """Return the path of the lock file of a device."""
    return Path(tempfile.gettempdir()) / f"ctr-station-{quote(device_name(url), safe='')}.lock"


def clear_left_behind() -> None:
    """Remove the lock files of this user that no process has locked, because killed stations leave them behind."""
    for path in Path(tempfile.gettempdir()).glob("ctr-station-*%2F*.lock"):  # a device's name has a slash
        with contextlib.suppress(OSError):  # the file is locked, belongs to another user, or was just removed
            if sys.platform != "win32" and path.lstat().st_uid == os.getuid():
                file = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    if os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False)):
                        path.unlink()
                finally:
                    os.close(file)


class PortLock:
    """Lock of one device: a lock on a file that is named after the device, kept while its link is open.

    Unix systems let two programs open one serial port, and a Net F/T box serves only the latest client. The operating
    system releases the lock when the process ends for any reason. On Windows this class locks nothing, because Windows
    opens a serial port only once.
    """

    def __init__(self, url: str) -> None:
        """Lock the device.

        Raises:
            PortInUse: a link of this or another process uses the device, or the lock file cannot be opened.
        """
        self._file: int | None = None
        if sys.platform == "win32":
            return
        self._path = lock_file(url)
        try:
            self._file = _locked(self._path)
        except BlockingIOError as error:
            holder = str(error)
            advice = "end that station, or configure another port"
            if holder == str(os.getpid()):
                advice = "this is the present process: two devices cannot use the same port"
            raise PortInUse(f"{url} is in use by process {holder or '(not known yet)'}; {advice}") from None
        except OSError as error:
            raise PortInUse(
                f"{url}: its lock file {self._path} cannot be opened: {error.strerror}; remove that file"
            ) from None

    def release(self) -> None:
        """Unlock the device."""
        if self._file is not None and sys.platform != "win32":
            # Remove the file while it is locked, because afterwards another station may lock it. A file of another
            # user cannot be removed and stays.
            with contextlib.suppress(OSError):
                self._path.unlink()
            # Unlock explicitly, because a child process may have inherited the open file and keep the lock.
            fcntl.flock(self._file, fcntl.LOCK_UN)
            os.close(self._file)
            self._file = None


def _locked(path: Path) -> int:
    """Lock the file, write this process's number into it, and return its descriptor.

    Raises:
        BlockingIOError: another link has locked the file; the text is the number of the locking process.
    """
    while True:
        file = _open_lock(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file), path.stat(follow_symlinks=False)):
                os.ftruncate(file, 0)
                os.pwrite(file, str(os.getpid()).encode(), 0)
                return file
            os.close(file)
        except FileNotFoundError:
            os.close(file)  # the previous owner has just removed the file
        except BlockingIOError:
            holder = os.pread(file, 20, 0).decode("ascii", "replace").strip()
            os.close(file)
            raise BlockingIOError(holder) from None


def _open_lock(path: Path) -> int:
    """Open the file so that any user may lock it, because a station of another account may use the same device."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        try:
            return os.open(path, flags)
        except FileNotFoundError:
            pass
        try:
            file = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue  # another process has created it
        os.fchmod(file, 0o666)  # independent of the umask of this process
        return file


class UsbPort(NamedTuple):
    """A serial port on USB, as the system describes it."""

    device: str  #: name of the port: /dev/ttyUSB0, COM3
    vendor: int
    product: int
    serial: str  #: serial number of the adapter; "" if it has none
    location: str  #: USB bus, chain of sockets, and interface on an adapter with several ports: 1-1.2:1.0

    def __str__(self) -> str:
        return f"USB adapter {self.vendor:04x}:{self.product:04x} " + (
            f"with serial number {self.serial}" if self.serial else f"at {self.location}"
        )


def usb_ports() -> list[UsbPort]:
    """Return the USB ports that are present."""
    return [
        UsbPort(str(port.device), port.vid, port.pid, port.serial_number or "", port.location or "")
        for port in cast(Sequence[Any], list_ports.comports())
        if port.vid is not None and port.pid is not None
    ]


def describe(device: str, ports: Sequence[UsbPort]) -> UsbPort | None:
    """Return the USB port that `device` names, directly or by a symbolic link; None if `device` is no USB port."""
    real = os.path.realpath(device)
    return next((port for port in ports if os.path.realpath(port.device) == real), None)


def find(known: UsbPort, ports: Sequence[UsbPort]) -> str | None:
    """Return the present name of a known adapter among `ports`; None if it is absent or ambiguous.

    A USB adapter that was unplugged may return under another name. It is recognised by its serial number or, if it has
    none, by its USB socket. The driver then identifies the device.
    """
    similar = [p for p in ports if (p.vendor, p.product, p.serial) == (known.vendor, known.product, known.serial)]
    if known.serial:
        # All ports of one adapter have the same serial number; they differ in the interface only.
        same = [p for p in similar if _interface(p) == _interface(known)]
    else:
        # Accept the same USB socket, or another socket if no second adapter of this kind is present.
        same = [p for p in similar if p.location == known.location] or similar
    return same[0].device if len(same) == 1 else None


def _interface(port: UsbPort) -> str:
    return port.location.partition(":")[2]


class Link(Protocol):
    """Interface of a link, which carries bytes to and from a device."""

    name: str  #: name of the link in messages

    def read(self) -> bytes:
        """Return the bytes that have arrived since the last read, without waiting.

        Raises:
            LinkError: the other end is gone.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send `data` without waiting.

        Raises:
            LinkError: the other end is gone or accepts no data.
        """
        ...

    def close(self) -> None:
        """Close the port."""
        ...


def reopen(link: Link) -> Link:
    """Open a lost link again, to the same device, under the present name of its port.

    Raises:
        LinkError: the device is absent, or this kind of link cannot be opened again.
    """
    again = getattr(link, "reopen", None)
    if again is None:
        raise LinkError(f"{link.name} cannot be opened again; restart the station")
    again()
    return link


class SerialLink:
    """A port that pyserial opens by name or URL: /dev/ttyUSB0, COM3, a pty, socket://host:port."""

    def __init__(self, url: str, baud: int) -> None:
        """Open the port; raises LinkError if the port cannot be opened or another program uses it."""
        self.name, self._baud = url, baud
        self._lock, self._port = _open(url, baud)
        self._is_port = "://" not in url
        #: USB adapter by which the port is found again after a loss; None if the port is not on USB.
        self._adapter = describe(url, usb_ports()) if self._is_port else None

    def read(self) -> bytes:
        """Return the bytes that the port has received."""
        try:
            # A read of an empty port waits for the kernel thread that transfers the port's bytes. The thread has normal
            # priority, so on a busy computer it waits for a processor, and the control loop would be late.
            if self._is_port and not self._port.in_waiting:
                return b""
            return bytes(self._port.read(65536))
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkError(f"{self.name} is gone: {error}") from None

    def write(self, data: bytes) -> None:
        """Write `data` to the port."""
        try:
            sent = self._sent(data)
        except BlockingIOError:
            sent = 0
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkError(f"{self.name} accepts no data: {error}") from None
        if sent < len(data):
            raise LinkError(f"{self.name} accepts no data: its buffer is full; does the device read?")

    def _sent(self, data: bytes) -> int:
        """Send `data` and return the number of sent bytes; without pyserial where possible, which retries forever."""
        if self.name.startswith("socket://") and (inner := _socket_of(self._port)) is not None:
            return inner.send(data)
        if self._is_port and os.name == "posix":
            return os.write(self._port.fd, data)
        return self._port.write(data)

    def set_baud(self, baud: int) -> None:
        """Change the rate of both directions [bit/s]."""
        try:
            self._port.baudrate = baud
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkError(f"{self.name} cannot run at {baud} baud: {error}") from None

    def set_break(self, low: bool) -> None:
        """Set the transmit line low (a break) or release it; the break lasts until the caller releases the line.

        On a pty or a socket, which cannot carry a break, the call has no effect.
        """
        with contextlib.suppress(serial.SerialException, OSError, NotImplementedError):
            self._port.break_condition = low

    def reopen(self) -> None:
        """Open the port of the same USB adapter again, under the port's present name and at its initial baud rate.

        Raises:
            LinkError: the adapter is not plugged in, or another program uses the port.
        """
        self.close()
        url = self.name
        if self._adapter is not None:
            url = find(self._adapter, usb_ports())
            if url is None:
                raise LinkError(f"{self.name} is gone and {self._adapter} was not found; is it plugged in?")
        self._lock, self._port = _open(url, self._baud)
        self.name = url

    def close(self) -> None:
        """Close the port."""
        # pyserial does not close the socket of a socket:// port whose peer has closed first.
        inner = _socket_of(self._port)
        self._port.close()
        if inner is not None:
            inner.close()
        self._lock.release()


def _socket_of(port: Any) -> socket.socket | None:
    """Return the socket of a socket:// port of pyserial."""
    inner = getattr(port, "_socket", None)
    return inner if isinstance(inner, socket.socket) else None


def _open(url: str, baud: int) -> tuple[PortLock, Any]:
    """Lock and open a port."""
    lock = PortLock(url)
    try:
        port = cast(Any, serial).serial_for_url(
            url, baudrate=baud, timeout=0.0, write_timeout=0.0, **({} if "://" in url else {"exclusive": True})
        )
        inner = _socket_of(port)
        if inner is not None:
            # Without this option a message waits up to 40 ms until the peer has acknowledged the previous message.
            inner.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return lock, port
    except (serial.SerialException, OSError, ValueError) as error:
        lock.release()
        raise LinkError(f"{url} cannot be opened: {error}; is it plugged in, and free?") from None


class DatagramLink:
    """Datagrams to and from one UDP peer."""

    def __init__(self, host: str, port: int) -> None:
        """Open the socket; raises LinkError if the address is unknown or another link uses it."""
        self.name = f"udp://{host}:{port}"
        self._lock = PortLock(self.name)
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
            self._socket.connect(address)
        except OSError as error:
            self._lock.release()
            raise LinkError(f"{self.name} cannot be reached: {error}") from None

    def receive(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        datagrams: list[bytes] = []
        while True:
            try:
                datagrams.append(self._socket.recv(65536))
            except BlockingIOError:
                return datagrams
            except ConnectionRefusedError:
                return datagrams  # the peer's port is closed; the driver detects the silence by its timeout
            except OSError as error:
                raise LinkError(f"{self.name} is gone: {error}") from None

    def send(self, datagram: bytes) -> None:
        """Send one datagram; it is lost if the buffer is full or the peer is absent, as in a network."""
        try:
            self._socket.send(datagram)
        except (BlockingIOError, ConnectionRefusedError):
            return
        except OSError as error:
            if error.errno not in (errno.ENETUNREACH, errno.EHOSTUNREACH):
                raise LinkError(f"{self.name} is gone: {error}") from None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        self._lock.release()


class DatagramInbox:
    """Datagrams that other processes of this computer send to a free UDP port."""

    def __init__(self) -> None:
        """Open a free port; raises LinkError if no port can be opened."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", 0))
        except OSError as error:
            self._socket.close()
            raise LinkError(f"no UDP port can be opened on this computer: {error}") from None
        self.port: int = self._socket.getsockname()[1]

    def receive(self) -> list[bytes]:
        """Return the datagrams that have arrived, at most `MAX_INBOX_DATAGRAMS`."""
        datagrams: list[bytes] = []
        while len(datagrams) < MAX_INBOX_DATAGRAMS:
            try:
                datagrams.append(self._socket.recv(2048))
            except BlockingIOError:
                break
            except OSError as error:
                raise LinkError(f"UDP port {self.port} is gone: {error}") from None
        return datagrams

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
