"""Frames of CANopen drives: identifiers, expedited SDOs, error codes, and the text protocol of serial CAN adapters.

Sources: CiA 301 (application layer), CiA 402 (drives; IEC 61800-7-201), and the Lawicel protocol of CAN232 adapters,
which slcan devices such as CANable use. Lines of an adapter have no checksum, but frames on the bus have one.
"""

import re
from typing import NamedTuple

from core.errors import CtrError
from station.devices.kernel.line import Unread

BIT_TIME_S = 1e-6  #: duration of a bit at 1 Mbit/s [s]
#: Bits of a frame without its data, and bits per byte of data; both with the largest number of stuff bits.
FRAME_BITS, BITS_PER_BYTE = 55, 10
MAX_LINE_BYTES = 32  #: a longer line is noise, because a frame of 8 bytes has 21 characters
#: Commands that open an adapter's channel at 1 Mbit/s: end an unfinished line of another program, close the channel,
#: set the rate, switch timestamps off (an adapter keeps this setting without power), and open the channel.
OPEN_ADAPTER = b"\r\rC\rS8\rZ0\rO\r"
HOST_NODE = 127  #: node number of the host

#: Base identifiers of the messages of a node; the node's number is added.
NMT, SYNC, EMERGENCY, STATUS, COMMAND, SDO_REPLY, SDO_REQUEST, HEARTBEAT = (
    0x000, 0x080, 0x080, 0x180, 0x200, 0x580, 0x600, 0x700,
)  # fmt: skip
START_NODE, STOP_NODE, PRE_OPERATIONAL = 0x01, 0x02, 0x80  #: commands of network management
BOOT_UP, OPERATIONAL = 0x00, 0x05  #: states in a heartbeat

#: Objects of the dictionary: index and subindex.
SERIAL_NUMBER, EMERGENCY_CODE = (0x1018, 4), (0x603F, 0)
CONTROLWORD, STATUSWORD, MODE = (0x6040, 0), (0x6041, 0), (0x6060, 0)
POSITION, TARGET_POSITION, TARGET_VELOCITY = (0x6064, 0), (0x607A, 0), (0x60FF, 0)

#: Values of the controlword.
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, RESET_FAULT = 0x06, 0x07, 0x0F, 0x0B, 0x80
START_MOTION = 0x1F  #: controlword of an enabled drive that starts a homing or a motion to a position
#: Bits of the statusword.
FAULT_BIT, TARGET_REACHED, HOMING_ATTAINED, HOMING_ERROR = 1 << 3, 1 << 10, 1 << 12, 1 << 13
STATE_MASK, ENABLED, STOPPED = 0x6F, 0x27, 0x07  #: states "operation enabled" and "quick stop active"
PROFILE_POSITION, PROFILE_VELOCITY, HOMING_MODE = 1, 3, 6  #: modes of operation

#: Meaning of emergency codes (CiA 301 and 402); a code that is missing has the meaning of its group, code & 0xF000.
EMERGENCIES = {
    0x1000: "general error",
    0x2000: "the current is wrong",
    0x2310: "the motor's current is too high",
    0x2320: "short circuit or earth fault of the motor",
    0x3000: "the voltage is wrong",
    0x3210: "the supply voltage is too high",
    0x3220: "the supply voltage is too low",
    0x4000: "the temperature is wrong",
    0x4210: "the drive is too hot",
    0x5000: "the drive's electronics have failed",
    0x6000: "the drive's program has failed",
    0x7000: "a module of the drive has failed",
    0x7305: "the encoder's signal is wrong",
    0x7500: "the communication has failed",
    0x8000: "monitoring has detected an error",
    0x8110: "CAN messages were lost",
    0x8120: "the CAN controller is error passive",
    0x8130: "the host's heartbeat is missing",
    0x8140: "the CAN controller has recovered from bus off",
    0x8611: "the position does not follow its command",
    0x8612: "a position limit was exceeded",
    0x9000: "an external error",
    0xF000: "an additional function has failed",
}
NO_OBJECT = 0x06020000  #: abort code of an SDO if the drive does not have the object
#: Meaning of the abort codes of SDOs (CiA 301).
ABORTS = {
    0x05040000: "timeout",
    0x06010002: "the object is read-only",
    NO_OBJECT: "the object does not exist",
    0x06040043: "incompatible parameter",
    0x06060000: "hardware error",
    0x06070010: "the length does not match",
    0x06090011: "the subindex does not exist",
    0x06090030: "the value is out of range",
    0x08000020: "the value cannot be stored",
    0x08000022: "not in this state of the drive",
}


class CanError(CtrError):
    """A drive is not the expected one, or does not execute its command."""


class Frame(NamedTuple):
    """One data frame with a base identifier."""

    identifier: int  #: 0 ... 0x7FF
    data: bytes  #: at most 8 bytes

    @property
    def duration(self) -> float:
        """Longest duration of the frame on the bus [s]."""
        return (FRAME_BITS + BITS_PER_BYTE * len(self.data)) * BIT_TIME_S


def encode(frame: Frame) -> bytes:
    """Return the line that makes an adapter send a frame."""
    return b"t%03X%d%s\r" % (frame.identifier, len(frame.data), frame.data.hex().upper().encode("ascii"))


_FRAME = re.compile(rb"t([0-7][0-9A-Fa-f]{2})([0-8])((?:[0-9A-Fa-f]{2})*)")


#: Lines of frames that only other devices send: frames with extended identifiers, and remote requests.
OTHER = re.compile(rb"T[0-9A-Fa-f]{8}[0-8](?:[0-9A-Fa-f]{2}){0,10}|[rR][0-9A-Fa-f]{3,8}[0-8](?:[0-9A-Fa-f]{4})?")
STAMP = re.compile(rb"[0-9A-Fa-f]{4}")  #: timestamp at the end of a frame's line [ms]
STAMPED_LINES = 3  #: lines with a timestamp in a row, after which lines with a timestamp are accepted


def decode(line: bytes, stamped: bool = False) -> Frame | None:
    """Return the frame in a line without its line end; None: no valid frame. `stamped`: a timestamp is expected."""
    if stamped:
        if not STAMP.fullmatch(line[-4:]):
            return None
        line = line[:-4]
    found = _FRAME.fullmatch(line)
    if found is None or len(found[3]) != 2 * int(found[2]):
        return None
    return Frame(int(found[1], 16), bytes.fromhex(found[3].decode("ascii")))


class FrameReader:
    """Divides the bytes of an adapter into frames, and counts the bytes of damaged lines."""

    def __init__(self) -> None:
        self.dropped = Unread()  #: bytes that belong to no valid line
        self._part = b""
        self._stamped = 0  # number of lines with a timestamp in a row

    @property
    def unread(self) -> bytes:
        """Newest bytes that belong to no valid line."""
        return self.dropped.last + (b"" if self._part[:1] in b"tTrRzZ" else self._part)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that `data` completes. The adapter's confirmations of sent frames are ignored."""
        frames: list[Frame] = []
        # Adapters confirm a line by CR, by LF, or refuse it by BEL without a CR.
        *lines, rest = (self._part + data).replace(b"\a", b"\r").replace(b"\n", b"\r").split(b"\r")
        for line in lines:
            frame = decode(line)
            if frame is not None:
                if self._stamped < STAMPED_LINES:
                    frames.append(frame)
                self._stamped = 0  # damage may have removed its timestamp, or made the lines before look stamped
            elif (timed := decode(line, stamped=True)) is not None:
                if self._stamped == STAMPED_LINES:
                    frames.append(timed)
                else:
                    self._stamped += 1
            elif not line.strip(b"zZ") or OTHER.fullmatch(line):
                self._stamped = 0
            else:
                self.dropped.add(line + b"\r")
        if len(rest) > MAX_LINE_BYTES:
            self.dropped.add(rest[:-MAX_LINE_BYTES])
        self._part = rest[-MAX_LINE_BYTES:]
        return frames


class SdoReply(NamedTuple):
    """Reply of a drive to an expedited SDO."""

    entry: tuple[int, int]  #: index and subindex of the object
    value: int  #: value read, unsigned; 0 after a write; abort code of a rejection
    accepted: bool


def upload(node: int, entry: tuple[int, int]) -> Frame:
    """Return the request to read an object of at most four bytes."""
    return Frame(SDO_REQUEST + node, b"\x40" + _entry(entry) + bytes(4))


def download(node: int, entry: tuple[int, int], value: int, size: int) -> Frame:
    """Return the request to write an object of 1, 2 or 4 bytes, signed or unsigned.

    Raises:
        CanError: the value does not fit into the object.
    """
    if not -(1 << 8 * size - 1) <= value < 1 << 8 * size:
        raise CanError(f"{text(entry)} = {value} does not fit into {size} bytes")
    command = 0x23 | (4 - size) << 2
    data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
    return Frame(SDO_REQUEST + node, bytes([command]) + _entry(entry) + data)


def sdo_reply(data: bytes) -> SdoReply | None:
    """Return the expedited SDO reply in a frame's data; None if the data are no such reply."""
    if len(data) != 8:
        return None
    command, entry = data[0], (int.from_bytes(data[1:3], "little"), data[3])
    value = int.from_bytes(data[4:], "little")
    if command == 0x60:
        return SdoReply(entry, 0, True)
    if command == 0x80:
        return SdoReply(entry, value, False)
    if command & 0xF3 != 0x43:
        return None
    size = 4 - (command >> 2 & 3)
    return SdoReply(entry, value & (1 << 8 * size) - 1, True)


def signed(value: int, size: int = 4) -> int:
    """Return an unsigned value of `size` bytes as a signed one."""
    return value - (1 << 8 * size) if value >> 8 * size - 1 else value


def text(entry: tuple[int, int]) -> str:
    """Return the number of an object as manuals print it."""
    return f"object 0x{entry[0]:04X}:{entry[1]:02X}"


def emergency_text(code: int) -> str:
    """Return the meaning of an emergency code with its number."""
    meaning = EMERGENCIES.get(code) or EMERGENCIES.get(code & 0xF000, "a drive's own error")
    return f"{meaning} (error 0x{code:04X})"


def abort_text(code: int) -> str:
    """Return the meaning of an SDO's abort code with its number."""
    return f"{ABORTS.get(code, 'rejected')} (abort 0x{code:08X})"


def _entry(entry: tuple[int, int]) -> bytes:
    return entry[0].to_bytes(2, "little") + bytes([entry[1]])
