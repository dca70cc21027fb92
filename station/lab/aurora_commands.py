"""The commands that a simulated Aurora executes: parsing, port handles, and the replies with frames to BX and TX."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from station.devices.aurora.protocol import (
    BAUD_CODES,
    ENABLED,
    IN_PORT,
    INITIALISED,
    OUT_OF_VOLUME,
    PORT_OCCUPIED,
    binary,
    crc16,
    framed,
)
from station.lab.aurora_coil import CoilView

MAX_COMMAND_BYTES = 512


class AuroraRefusal(Exception):
    """A command that the simulated tracker refuses with an ERROR reply; it is not an error of this program."""

    def __init__(self, code: int) -> None:
        self.code = code


def parse_command(line: bytes) -> tuple[str, str]:
    """Return name and parameters of a command line, which is `CMD:params` + CRC or `CMD params`."""
    if len(line) > MAX_COMMAND_BYTES:
        raise AuroraRefusal(0x02)
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError:
        raise AuroraRefusal(0x04) from None
    name, separator, parameters = text.partition(":")
    if separator and " " not in name:
        if len(parameters) < 4:
            raise AuroraRefusal(0x03)
        if parameters[-4:].upper() != f"{crc16(line[:-4]):04X}":
            raise AuroraRefusal(0x04)
        return name.upper(), parameters[:-4]
    name, separator, parameters = text.partition(" ")
    if not separator:
        raise AuroraRefusal(0x01)
    return name.upper(), parameters


def number(digits: str, count: int) -> int:
    """Return the number of exactly `count` hexadecimal digits."""
    if len(digits) != count:
        raise AuroraRefusal(0x03 if len(digits) < count else 0x02)
    if not all(digit in "0123456789abcdefABCDEF" for digit in digits):
        raise AuroraRefusal(0x23)
    return int(digits, 16)


def parse_rate(parameters: str) -> tuple[int, int]:
    """Return baud rate and bits per character from the five digits of the command COMM."""
    if len(parameters) != 5:
        raise AuroraRefusal(0x03 if len(parameters) < 5 else 0x02)
    bauds = {code: baud for baud, code in BAUD_CODES.items()}
    rate, data, parity, stop, handshake = parameters.upper()
    if rate not in bauds or data not in "01" or parity not in "012" or stop not in "01" or handshake not in "01":
        raise AuroraRefusal(0x06)
    return bauds[rate], 1 + 8 - int(data) + (parity != "0") + 1 + int(stop)


@dataclass
class ToolPort:
    """A port handle: the number that the tracker gives to a plugged-in tool."""

    handle: int
    serial: str  #: serial number of the tool; "" for an unprogrammed tool, which cannot be initialised
    target: bool = False  #: whether the tool is the target's coil instead of the tip's
    initialised: bool = False
    enabled: bool = False
    channel: int = 0  #: number of the coil in its plug
    port: int = 1  #: number of the plug's port
    gone: bool = False  #: whether the tool is unplugged and its handle not yet freed

    @property
    def status(self) -> int:
        """Status bits of the port handle."""
        return (0 if self.gone else IN_PORT) | (INITIALISED * self.initialised) | (ENABLED * self.enabled)


class PortHandles:
    """All port handles of a tracker with the tip's coil and, optionally, a target's coil and an unprogrammed tool."""

    def __init__(self, serial: str, target: str = "", unprogrammed: bool = False, dual: bool = False) -> None:
        """With `dual`, both coils are in one plug: the second one gets its handle when the first is initialised."""
        self._serial, self._target, self._unprogrammed, self._dual = serial, target, unprogrammed, dual
        self.ports = self._plugged()
        self.changed = 0  #: system status bits, cleared when the host reads the ports

    def unplug(self) -> None:
        """Pull the plug of the tip's coil."""
        self._tip.gone = True
        self.changed |= 0x80

    def plug(self) -> None:
        """Plug the tip's coil in again; it gets a new handle."""
        self.ports.append(ToolPort((max(port.handle for port in self.ports) + 1) & 0xFF, self._serial))
        self.changed |= PORT_OCCUPIED

    def restart(self) -> None:
        """Reset all handles to the state after power-up."""
        tip = self._tip
        self.ports = self._plugged()
        if tip.gone:
            self.ports[0] = tip

    @property
    def _tip(self) -> ToolPort:
        """The newest handle of the tip's coil."""
        return next(port for port in reversed(self.ports) if port.serial and not port.target)

    def _plugged(self) -> list[ToolPort]:
        """Return the handles that plugged-in tools get at power-up."""
        target = [ToolPort(0x0B, self._target, target=True, port=2)] if self._target and not self._dual else []
        return [ToolPort(0x0A, self._serial), *target, *([ToolPort(0x0C, "", port=3)] if self._unprogrammed else [])]

    def forget(self) -> None:
        """Reset all tools to not initialised and not enabled, as INIT does."""
        for port in self.ports:
            port.initialised = port.enabled = False

    def enabled(self) -> list[ToolPort]:
        """Return the handles of the enabled tools, which the frames contain."""
        return [port for port in self.ports if port.enabled]

    def search(self, parameters: str) -> str:
        """Return the answer to PHSR, which searches for port handles; clear the reported changes."""
        tests = {
            0: lambda port: True,  # noqa: ARG005
            1: lambda port: port.gone,
            2: lambda port: not port.gone and not port.initialised,
            3: lambda port: not port.gone and port.initialised and not port.enabled,
            4: lambda port: not port.gone and port.enabled,
        }
        which = number(parameters or "00", 2)
        if which not in tests:
            raise AuroraRefusal(0x23)
        self.changed = 0
        found = [port for port in self.ports if tests[which](port)]
        return f"{len(found):02X}" + "".join(f"{port.handle:02X}{port.status:03X}" for port in found)

    def information(self, parameters: str) -> str:
        """Return the answer to PHINF, which requests information about a port handle."""
        port = self._port(parameters[:2])
        options = number(parameters[2:] or "0001", 4)
        if port.gone:
            return "UNOCCUPIED"
        if options not in (0x0001, 0x0021):
            raise AuroraRefusal(0x23)
        place = f"{'00000000':8}10{port.port:02}{port.channel:02X}" if options & 0x0020 else ""
        return f"{'02000000':8}{'simulated':12}{'001':3}{port.serial:8}{port.status:02X}{place}"

    def change(self, name: str, parameters: str, tracking: bool) -> None:
        """Execute PINIT, PENA or PHF: initialise, enable or free a port handle."""
        port = self._port(parameters[:2])
        if tracking:
            raise AuroraRefusal(0x0C)
        priority = parameters[2:]
        if name == "PENA" and (len(priority) != 1 or priority not in "SDB"):
            raise AuroraRefusal(0x09)
        if name != "PENA" and priority:
            raise AuroraRefusal(0x02)
        if name == "PHF":
            port.initialised = port.enabled = False
            if port.gone and len(self.ports) > 1:
                self.ports.remove(port)
        elif port.gone:
            raise AuroraRefusal(0x0D)
        elif name == "PINIT":
            if not port.serial:
                raise AuroraRefusal(0x13)
            port.initialised = True
            if self._dual and len(self.ports) == 1:
                self.ports.append(ToolPort(0x0B, port.serial, target=True, channel=1))
        elif not port.initialised:
            raise AuroraRefusal(0x0E)
        else:
            port.enabled = True

    def _port(self, digits: str) -> ToolPort:
        handle = number(digits, 2)
        for port in self.ports:
            if port.handle == handle:
                return port
        raise AuroraRefusal(0x08)


FIT_ERROR = 0.12  #: fit error reported with a transform [mm]
OPTION_TRANSFORMS, OPTION_BEYOND_VOLUME = 0x0001, 0x0800


def requests_beyond_volume(options: int) -> bool:
    """Return whether `options` of BX or TX also request the transforms of tools outside the measurement volume.

    Raises:
        AuroraRefusal: the simulated tracker does not support a requested option.
    """
    if not options & OPTION_TRANSFORMS:
        raise AuroraRefusal(0x23)
    if options & ~(OPTION_TRANSFORMS | OPTION_BEYOND_VOLUME):
        raise AuroraRefusal(0x33)
    return bool(options & OPTION_BEYOND_VOLUME)


def bx_reply(tools: Sequence[tuple[ToolPort, CoilView | None]], beyond: bool, system_status: int) -> bytes:
    """Return the binary reply to BX: all enabled ports and the frames of their coils."""
    body = bytes([len(tools)]) + b"".join(_bx_tool(port, view, beyond) for port, view in tools)
    return binary(body + struct.pack("<H", system_status))


def tx_reply(tools: Sequence[tuple[ToolPort, CoilView | None]], beyond: bool, system_status: int) -> bytes:
    """Return the text reply to TX: all enabled ports and the frames of their coils."""
    text = f"{len(tools):02X}" + "".join(_tx_tool(port, view, beyond) for port, view in tools)
    return framed(text + f"{system_status:04X}")


def _status(port: ToolPort, view: CoilView | None) -> int:
    return port.status | (OUT_OF_VOLUME if view is not None and not port.gone and view.beyond > 0.0 else 0)


def _visible(view: CoilView | None, beyond: bool) -> bool:
    return view is not None and not view.lost and (beyond or view.beyond <= 0.0)


def _bx_tool(port: ToolPort, view: CoilView | None, beyond: bool) -> bytes:
    if port.gone:
        return bytes([port.handle, 0x04])
    tail = struct.pack("<II", _status(port, view), view.frame if view else 0)
    if view is None or not _visible(view, beyond):
        return bytes([port.handle, 0x02]) + tail
    return bytes([port.handle, 0x01]) + struct.pack("<8f", *view.quaternion, *view.position, FIT_ERROR) + tail


def _tx_tool(port: ToolPort, view: CoilView | None, beyond: bool) -> str:
    if port.gone:
        return f"{port.handle:02X}UNOCCUPIED\n"
    tail = f"{_status(port, view):08X}{view.frame if view else 0:08X}\n"
    if view is None or not _visible(view, beyond):
        return f"{port.handle:02X}MISSING{tail}"
    rotation = "".join(f"{round(1e4 * value):+06d}" for value in view.quaternion)
    position = "".join(f"{round(1e2 * value):+07d}" for value in view.position)
    return f"{port.handle:02X}{rotation}{position}{round(1e4 * FIT_ERROR):+06d}{tail}"
