"""The protocol of an NDI Aurora tracker (Combined API): framing of commands and replies, and parsers of the replies.

A command consists of text, the CRC of the text and a carriage return. Most replies have the same form. The reply to the
command BX is binary: C4 A5, body length, CRC of the header, body, CRC of the body, all little-endian. The reader drops
and counts bytes without a correct CRC. One corrupted reply in 65536 passes this check: the parsers therefore raise for
replies of a wrong form and for numbers outside the tracker's range, and name the wrong part.
Formats and numbers follow the manufacturer's Combined API as public clients implement it. Values that were not
confirmed on a real tracker are marked as unconfirmed.
"""

import math
import re
import struct
from enum import Enum
from typing import NamedTuple

from core.compiled import compiled
from core.errors import CtrError

#: Code of each baud rate [bit/s] in the command COMM; after power-up the unit uses 9600.
BAUD_CODES = {
    9600: "0",
    14400: "1",
    19200: "2",
    38400: "3",
    57600: "4",
    115200: "5",
    921600: "6",
    1228739: "7",
    230400: "A",
}
POWER_UP_BAUD = 9600
START_SEQUENCE = b"\xc4\xa5"  #: first bytes of a binary reply
MAX_TEXT_BYTES = 4096  #: longest text reply; longer text counts as noise [bytes]
MAX_BODY_BYTES = 1 + 255 * 42 + 2  #: longest body of a BX reply, with one entry for each possible handle [bytes]


class AuroraError(CtrError):
    """The unit refused a command, did not answer, or gave an invalid answer."""


@compiled
def crc16(data: bytes) -> int:
    """Return the CRC-16/ARC: polynomial x^16 + x^15 + x^2 + 1, reflected, initial value 0, no final XOR."""
    crc = 0
    for k in range(len(data)):
        crc ^= data[k]
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def framed(text: str) -> bytes:
    """Return a command such as `PHSR:02` or a text reply such as `OKAY`, with CRC and CR."""
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


def binary(body: bytes) -> bytes:
    """Return a binary reply with `body`."""
    header = START_SEQUENCE + struct.pack("<H", len(body))
    return header + struct.pack("<H", crc16(header)) + body + struct.pack("<H", crc16(body))


_TEXT_END = re.compile(rb"[\r\x80-\xff]")
_PERHAPS_A_START = re.compile(rb"[\x00-\x7f\xc4]")


class ReplyReader:
    """Splits a byte stream into replies, however the stream was divided into reads; without I/O."""

    def __init__(self) -> None:
        self.noise = 0  #: bytes that belonged to no reply
        self.crc_errors = 0  #: texts and binary bodies whose CRC was wrong
        self._buffer = bytearray()
        crc16(b"")  # loads the compiled code here, not in the control loop

    def feed(self, data: bytes) -> list[str | bytes]:
        """Return the replies that `data` completes: text as str, the body of a binary reply as bytes."""
        self._buffer += data
        replies: list[str | bytes] = []
        while self._buffer:
            if not (self._text(replies) if self._buffer[0] < 0x80 else self._binary(replies)):
                break
        return replies

    def drop(self) -> None:
        """Discard an incomplete reply."""
        self._skip(len(self._buffer))

    def _skip(self, count: int) -> None:
        self.noise += count
        del self._buffer[:count]

    def _text(self, replies: list[str | bytes]) -> bool:
        """Remove a text reply or noise from the buffer; return False if more bytes are needed."""
        found = _TEXT_END.search(self._buffer)
        if found is None:
            if len(self._buffer) <= MAX_TEXT_BYTES:
                return False
            self.drop()
            return True
        end = found.start()
        if self._buffer[end] != 0x0D:
            self._skip(end)
        elif end >= 4 and self._buffer[end - 4 : end] == b"%04X" % crc16(bytes(self._buffer[: end - 4])):
            replies.append(self._buffer[: end - 4].decode("ascii"))
            del self._buffer[: end + 1]
        else:
            self.crc_errors += 1
            self._skip(end + 1)
        return True

    def _binary(self, replies: list[str | bytes]) -> bool:
        """Remove a complete binary reply or noise from the buffer; return False if more bytes are needed."""
        if not START_SEQUENCE.startswith(self._buffer[:2]):
            return self._skip_to_a_start()
        if len(self._buffer) < 6:
            return False
        length, check = struct.unpack_from("<HH", self._buffer, 2)
        if check != crc16(bytes(self._buffer[:4])) or length > MAX_BODY_BYTES:
            return self._skip_to_a_start()
        if len(self._buffer) < length + 8:
            return False
        body = bytes(self._buffer[6 : 6 + length])
        if struct.unpack_from("<H", self._buffer, 6 + length)[0] == crc16(body):
            replies.append(body)
            del self._buffer[: length + 8]
            return True
        # Skip only to the next possible start: if bytes were lost, the next reply starts within these bytes.
        self.crc_errors += 1
        return self._skip_to_a_start()

    def _skip_to_a_start(self) -> bool:
        """Drop the first byte and all bytes up to the next possible start of a reply."""
        found = _PERHAPS_A_START.search(self._buffer, 1)
        self._skip(found.start() if found else len(self._buffer))
        return True


LARGEST_COORDINATE = 9999.99  #: largest coordinate that a TX reply can contain; also applied to BX replies [mm]
LARGEST_ERROR = 9.9999  #: largest error indicator that a TX reply can contain; also applied to BX replies [mm]
NORM_TOLERANCE = 0.01  #: largest deviation of a quaternion's norm from 1; TX prints four decimals

#: Port status bits of a handle.
IN_PORT, INITIALISED, ENABLED = 0x01, 0x10, 0x20
OUT_OF_VOLUME, PARTLY_OUT_OF_VOLUME = 0x40, 0x80
#: System status bits.
SYSTEM_FAULTS = {
    0x01: "communication synchronisation lost",
    0x02: "interference from outside",
    0x04: "communication CRC",
    0x08: "recoverable processing fault",
    0x10: "hardware failure",
}
HARDWARE_FAILURE, PORT_OCCUPIED = 0x10, 0x40

#: Meaning of the number in an ERROR reply.
ERRORS = {
    0x01: "invalid command",
    0x02: "command too long",
    0x03: "command too short",
    0x04: "the command's CRC is wrong",
    0x05: "the command timed out",
    0x06: "unsupported communication parameters",
    0x07: "wrong number of parameters",
    0x08: "invalid port handle",
    0x09: "invalid tracking priority",
    0x0C: "not in this mode",
    0x0D: "no tool at this handle",
    0x0E: "port handle not initialised",
    0x0F: "port handle not enabled",
    0x10: "system not initialised",
    0x11: "tracking could not be stopped",
    0x12: "tracking could not be started",
    0x13: "the tool could not be initialised",
    0x1A: "internal error of the unit",
    0x23: "parameter out of range",
    0x28: "too many tools enabled",
    0x2B: "port handle not allocated",
    0x2C: "port handle unoccupied",
    0x32: "invalid operation",
    0x33: "feature not available",
}
NOT_IN_THIS_MODE = 0x0C


class ToolState(Enum):
    """State of a handle in a BX or TX reply."""

    VALID = "valid"
    MISSING = "missing"
    DISABLED = "disabled"
    UNOCCUPIED = "unoccupied"


class Transform(NamedTuple):
    """Pose of a tool in the field generator's frame."""

    quaternion: tuple[float, ...]  #: unit quaternion q0 qx qy qz
    position: tuple[float, ...]  #: position x y z [mm]
    error: float  #: the unit's error indicator of the fit [mm]

    @property
    def axis(self) -> tuple[float, ...]:
        """The tool's z axis, along the coil, as a unit vector: independent of the roll angle."""
        w, x, y, z = self.quaternion
        return (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))

    def ahead(self, distance: float) -> tuple[float, ...]:
        """Return the point at `distance` [mm] from the tool's origin along its axis [mm]."""
        if distance == 0.0:
            return self.position
        return tuple(p + distance * a for p, a in zip(self.position, self.axis, strict=True))


class ToolFrame(NamedTuple):
    """State and pose of one handle's tool in one frame."""

    handle: int
    state: ToolState
    transform: Transform | None  #: None unless `state` is VALID
    port_status: int = 0
    frame: int | None = None  #: None if the reply has no frame number


class FrameReply(NamedTuple):
    """Content of a BX or TX reply with reply option 0001, with or without 0800."""

    tools: tuple[ToolFrame, ...]
    system_status: int

    def tool(self, handle: int | None) -> ToolFrame | None:
        """Return the frame of the tool with this handle; None if the reply does not contain it."""
        for tool in self.tools:
            if tool.handle == handle:
                return tool
        return None


def _transform(values: tuple[float, ...], handle: int) -> Transform:
    """Return the transform; raise for numbers out of range, because one damaged reply in 65536 passes the CRC."""
    if not all(map(math.isfinite, values)):
        raise AuroraError(f"handle {handle:02X}: the transform is not finite")
    norm = math.hypot(*values[:4])
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise AuroraError(f"handle {handle:02X}: quaternion of norm {norm:.4g}, not within {NORM_TOLERANCE:g} of 1")
    for axis, value in zip("xyz", values[4:7], strict=True):
        if abs(value) > LARGEST_COORDINATE:
            raise AuroraError(f"handle {handle:02X}: {axis} = {value:.6g} mm is beyond {LARGEST_COORDINATE:g} mm")
    if not 0.0 <= values[7] <= LARGEST_ERROR:
        raise AuroraError(f"handle {handle:02X}: error {values[7]:.4g} mm is not within 0 ... {LARGEST_ERROR:g} mm")
    return Transform(values[:4], values[4:7], values[7])


_BX_STATES = {0x01: ToolState.VALID, 0x02: ToolState.MISSING, 0x04: ToolState.DISABLED}


def parse_bx(body: bytes) -> FrameReply:
    """Return the content of a BX reply's body.

    Raises:
        AuroraError: the reply is malformed.
    """
    tools: list[ToolFrame] = []
    try:
        at = 1
        for _ in range(body[0]):
            handle, status = body[at], body[at + 1]
            at += 2
            state = _BX_STATES.get(status)
            if state is None:
                raise AuroraError(f"handle {handle:02X}: status {status:02X} is none of 01, 02, 04")
            transform, port_status, frame = None, 0, None
            if state is ToolState.VALID:
                transform = _transform(struct.unpack_from("<8f", body, at), handle)
                at += 32
            if state is not ToolState.DISABLED:
                port_status, frame = struct.unpack_from("<II", body, at)
                at += 8
            tools.append(ToolFrame(handle, state, transform, port_status, frame))
        (system,) = struct.unpack_from("<H", body, at)
    except (IndexError, struct.error):
        raise AuroraError(f"BX reply of {len(body)} bytes ends early") from None
    if at + 2 != len(body):
        raise AuroraError(f"BX reply of {len(body)} bytes is longer than its {at + 2} bytes of content")
    return FrameReply(tuple(tools), system)


#: Entry of a handle in a TX reply. As in the public client ndicapi, DISABLED may lack status and frame number.
_TX_TOOL = re.compile(
    r"([0-9A-F]{2})(?:(UNOCCUPIED|DISABLED(?=\n))\n?|"
    r"(?:(MISSING|DISABLED)|((?:[+-]\d{5}){4}(?:[+-]\d{6}){3}[+-]\d{5}))([0-9A-F]{8})([0-9A-F]{8})\n)"
)
_TX_FIELDS = (*((i, i + 6, 1e4) for i in (0, 6, 12, 18)), *((i, i + 7, 1e2) for i in (24, 31, 38)), (45, 51, 1e4))


def parse_tx(text: str) -> FrameReply:
    """Return the content of a TX reply without its CRC.

    Raises:
        AuroraError: the reply is malformed.
    """
    tools: list[ToolFrame] = []
    count, at = _hex(text[:2], 2, "number of handles"), 2
    for _ in range(count):
        match = _TX_TOOL.match(text, at)
        if match is None:
            raise AuroraError(f"TX reply has no entry of a handle at character {at}: {text[at : at + 20]!r}")
        handle = int(match[1], 16)
        at = match.end()
        if match[2]:
            tools.append(ToolFrame(handle, ToolState[match[2]], None))
            continue
        transform = None
        if match[4]:
            transform = _transform(tuple(int(match[4][a:b]) / scale for a, b, scale in _TX_FIELDS), handle)
        state = ToolState.VALID if transform else ToolState[match[3]]
        tools.append(ToolFrame(handle, state, transform, int(match[5], 16), int(match[6], 16)))
    return FrameReply(tuple(tools), _hex(text[at:], 4, "system status"))


def parse_phsr(text: str) -> list[tuple[int, int]]:
    """Return the handles and their status bits from a PHSR reply.

    Raises:
        AuroraError: the reply is malformed.
    """
    count = _hex(text[:2], 2, "number of handles")
    if len(text) != 2 + 5 * count:
        raise AuroraError(f"PHSR reply of {len(text)} characters for {count} handles, not {2 + 5 * count}")
    return [
        (_hex(text[i : i + 2], 2, "handle"), _hex(text[i + 2 : i + 5], 3, "status")) for i in range(2, len(text), 5)
    ]


PHINF_LENGTHS = (33, 47)  #: lengths of PHINF replies without and with the port of the tool


class ToolIdentity(NamedTuple):
    """Content of a PHINF reply with reply option 0001, with or without 0020."""

    kind: str  #: tool type, 8 characters
    maker: str
    revision: str
    serial: str
    status: int
    port: int | None = None  #: number of the tool's port; None: unknown
    channel: int | None = None  #: number of the coil in its plug; None: unknown


def parse_phinf(text: str) -> ToolIdentity | None:
    """Return the identity of a tool; None if the port is unoccupied.

    Raises:
        AuroraError: the reply is malformed.
    """
    if text == "UNOCCUPIED":
        return None
    if len(text) not in PHINF_LENGTHS:
        raise AuroraError(f"PHINF reply of {len(text)} characters, not {' or '.join(map(str, PHINF_LENGTHS))}")
    kind, maker, revision, serial = (text[a:b].strip() for a, b in ((0, 8), (8, 20), (20, 23), (23, 31)))
    status, place = _hex(text[31:33], 2, "status"), text[33:]
    if not place:
        return ToolIdentity(kind, maker, revision, serial, status)
    # `place`: number of the unit (8 characters), its kind, whether the tool is wireless, port (decimal), and channel.
    port = int(place[10:12]) if place[10:12].isdecimal() else None
    return ToolIdentity(kind, maker, revision, serial, status, port, _hex(place[12:], 2, "channel"))


def error_code(text: str) -> int | None:
    """Return the number of an ERROR reply; None for any other reply."""
    found = re.fullmatch(r"ERROR([0-9A-F]{2})", text)
    return int(found[1], 16) if found else None


def error_words(code: int) -> str:
    """Return the meaning of an error code."""
    return f"{ERRORS.get(code, 'unknown error')} (ERROR{code:02X})"


def system_words(status: int) -> str:
    """Return the faults of the system status as text; empty if there is none."""
    return ", ".join(words for bit, words in SYSTEM_FAULTS.items() if status & bit)


def _hex(text: str, digits: int, what: str) -> int:
    if not re.fullmatch(rf"[0-9A-Fa-f]{{{digits}}}", text):
        raise AuroraError(f"{what} is {text[:20]!r}, not {digits} hex digits")
    return int(text, 16)
