"""Binary protocol of Zaber T-series stages with firmware 5.xx: messages, units, command numbers, error texts.

A message has six bytes in both directions and no checksum, so a lost byte shifts the boundaries of all following
messages. The parser finds the boundaries again after a silence of more than 10 ms, as the units do, and by the
plausibility of the messages.
Sources: the manufacturer's Binary Protocol Manual, and the T-Series pages of the manufacturer's wiki.
"""

import math
import struct
from collections.abc import Callable, Collection
from enum import IntEnum
from typing import NamedTuple

from core.errors import CtrError
from station.devices.kernel.line import AxisLost, TwoDevices, UnexpectedMotion, Unread

BAUD = 9600  #: baud rate, fixed in the T-series; 8N1 without handshake [bit/s]
BYTE_TIME_S = 10.0 / BAUD  #: transmission time of a byte [s]
MESSAGE_BYTES = 6  #: length of a message [bytes]
MESSAGE_TIME_S = MESSAGE_BYTES * BYTE_TIME_S  #: 6.25 ms per message: 160 messages per second in each direction
RESYNC_GAP_S = 0.010  #: a unit drops a message if the pause between two of its bytes is longer [s]

SPEED_UNIT = 9.375  #: unit of speeds in messages [microsteps/s]; different from firmware 6 on
ACCELERATION_UNIT = 11250.0  #: unit of accelerations in messages [microsteps/s^2]; different from firmware 6 on
MAX_POSITION = 16_777_215  #: largest value that the command Set Maximum Position accepts [microsteps]
MICROSTEP_RESOLUTION = 64  #: factory setting: microsteps per full step of the motor

_FRAME = struct.Struct("<BBi")


class ZaberError(CtrError):
    """A message is invalid, a unit is not the expected one, or a stage does not execute its command."""


class ZaberCommand(IntEnum):
    """Command numbers of messages; MOVE_TRACKING, LIMIT_ACTIVE, MANUAL_MOVE and ERROR are sent by units only."""

    RESET = 0
    HOME = 1
    RENUMBER = 2
    MOVE_TRACKING = 8
    LIMIT_ACTIVE = 9
    MANUAL_MOVE = 10
    MOVE_ABSOLUTE = 20
    MOVE_RELATIVE = 21
    MOVE_SPEED = 22
    STOP = 23
    RESTORE = 36
    SET_RESOLUTION = 37
    SET_MODE = 40
    SET_HOME_SPEED = 41
    SET_SPEED = 42
    SET_ACCELERATION = 43
    SET_MAXIMUM = 44
    SET_POSITION = 45
    SET_HOME_OFFSET = 47
    SET_ALIAS = 48
    SET_LOCK = 49
    DEVICE_ID = 50
    FIRMWARE = 51
    SETTING = 53
    STATUS = 54
    ECHO = 55
    POSITION = 60
    SERIAL_NUMBER = 63
    ERROR = 255


class Mode(IntEnum):
    """Bits of the setting Set Device Mode (40); each write replaces all bits, including the homed flag."""

    NO_AUTO_REPLY = 1 << 0  #: the unit answers only the commands Return, Echo, Renumber and Read
    NO_KNOB = 1 << 3
    MOVE_TRACKING = 1 << 4
    MESSAGE_IDS = 1 << 6
    HOMED = 1 << 7


class ZaberStatus(IntEnum):
    """Replies to the command Return Status (54) that this driver uses."""

    IDLE = 0
    HOMING = 1
    STOPPING = 23


class Code(IntEnum):
    """Error codes to which the driver or the simulated unit reacts."""

    UNKNOWN_COMMAND = 64
    BUSY = 255


#: Meaning of each error code. Source: manufacturer's wiki, "Error / T-Series Motorized Devices".
ERRORS = {
    1: "cannot home: the home sensor was not found",
    2: "device number out of range",
    14: "supply voltage too low",
    15: "supply voltage too high",
    18: "stored position out of range",
    20: "target of an absolute move out of range",
    21: "target of a relative move out of range",
    22: "speed of a constant-speed move out of range",
    36: "restore key wrong",
    37: "microstep resolution not possible",
    38: "run current out of range",
    39: "hold current out of range",
    40: "device mode not possible",
    41: "home speed out of range",
    42: "target speed out of range",
    43: "acceleration out of range",
    44: "maximum position out of range",
    45: "current position out of range",
    46: "largest relative move out of range",
    47: "home offset out of range",
    48: "alias out of range",
    49: "lock state not possible",
    53: "unknown setting",
    64: "unknown command",
    255: "busy with another command",
    1600: "address of a stored position out of range (save)",
    1601: "position cannot be stored: the stage is not homed",
    1700: "address of a stored position out of range (return)",
    1800: "address of a stored position out of range (move)",
    1801: "no move to a stored position: the stage is not homed",
    2146: "relative move longer than its limit",
    3600: "settings are locked",
}


def error_text(code: int) -> str:
    """Return the meaning of an error reply as text."""
    if 4000 <= code <= 4031:
        return f"error {code}: bit {code - 4000} of the device mode is not possible"
    return f"error {code}: {ERRORS.get(code, 'not in the list of the T-series')}"


class ZaberMessage(NamedTuple):
    """A message of six bytes, from the host to a unit or back."""

    device: int  #: device number of the unit; 0 addresses every unit
    command: int
    data: int  #: signed 32 bits


def encode(message: ZaberMessage) -> bytes:
    """Return the bytes of a message.

    Raises:
        ZaberError: a field of the message is out of its range.
    """
    device, command, data = message
    for what, value in (("device", device), ("command", command)):
        if not 0 <= value <= 255:
            raise ZaberError(f"{what} {value} is outside 0 ... 255 (one byte)")
    if not -(1 << 31) <= data < 1 << 31:
        raise ZaberError(f"data {data} is outside -2^31 ... 2^31 - 1 (four bytes)")
    return _FRAME.pack(device, command, data)


def decode(frame: bytes) -> ZaberMessage:
    """Return the message in six bytes."""
    return ZaberMessage._make(_FRAME.unpack(frame))


def with_id(data: int, identity: int) -> int:
    """Return the data of a message in message-ID mode: 24 signed bits, and the ID in the sixth byte."""
    word = (data & 0xFFFFFF) | (identity & 0xFF) << 24
    return word - (1 << 32) if word >= 1 << 31 else word


def split_id(word: int) -> tuple[int, int]:
    """Return data and ID of a message in message-ID mode."""
    data = word & 0xFFFFFF
    return (data - (1 << 24) if data >= 1 << 23 else data), (word >> 24) & 0xFF


def top_speed(resolution: int) -> int:
    """Return the largest setting of speed or acceleration that units accept at a resolution [their units]."""
    return 512 * resolution - 1


def speed_data(microsteps_per_s: float) -> int:
    """Return a speed, rounded to whole speed units as messages carry it.

    Raises:
        ZaberError: the speed is not finite.
    """
    if not math.isfinite(microsteps_per_s):
        raise ZaberError(f"speed {microsteps_per_s} microsteps/s is not finite")
    return round(microsteps_per_s / SPEED_UNIT)


class ZaberParser:
    """Extracts messages from a byte stream that may be split anywhere, damaged or noisy."""

    def __init__(self, plausible: Callable[[ZaberMessage], bool] | None = None, gap: float = RESYNC_GAP_S) -> None:
        """`plausible` returns whether a message is valid; by default any six bytes form a message.

        `gap` is the length of a silence after which an incomplete message is dropped [s].
        """
        self.dropped = Unread()  #: bytes that belong to no message
        self.resyncs = 0  #: how many times the message boundaries were lost
        self._plausible = plausible
        self._gap = gap
        self._buffer = bytearray()
        self._last = -math.inf
        self._lost = False

    def feed(self, data: bytes, now: float, since: float | None = None) -> list[ZaberMessage]:
        """Return the messages that `data` completes. `data` arrived at `now`, or between `since` and `now` [s].

        If reads are farther apart than `gap`, a silence cannot be detected; the parser then assumes no silence.
        """
        if not data:
            return []
        buffer = self._buffer
        if (now if since is None else since) - self._last > self._gap:
            self._lost = False
            if buffer:
                self._drop(len(buffer))
        self._last = now
        buffer += data
        if len(buffer) < MESSAGE_BYTES:
            return []
        found: list[ZaberMessage] = []
        start = 0
        while len(buffer) - start >= MESSAGE_BYTES:
            message = ZaberMessage._make(_FRAME.unpack_from(buffer, start))
            if self._plausible is None or self._plausible(message):
                found.append(message)
                start += MESSAGE_BYTES
                self._lost = False
            else:
                self.resyncs += not self._lost
                self._lost = True
                self.dropped.add(bytes((buffer[start],)))
                start += 1
        del buffer[:start]
        return found

    @property
    def unread(self) -> bytes:
        """Newest bytes that belong to no message or to an incomplete one."""
        return bytes(self.dropped.last + self._buffer)

    def _drop(self, count: int) -> None:
        self.dropped.add(bytes(self._buffer[:count]))
        self.resyncs += 1
        del self._buffer[:count]


class Request(NamedTuple):
    """One query or setting of one axis."""

    axis: int
    command: int
    data: int = 0
    reply: int | None = None  #: command number of the reply; None: no reply is expected


class Reply(NamedTuple):
    """Result of a `Request`."""

    data: int | None = None  #: data of the reply; None: no reply came in time, or none is expected
    error: int | None = None  #: error code; None: no error reply


class ResetDone(NamedTuple):
    """Event: the host has reset an axis that did not stop its homing; the position of the axis is unknown."""

    axis: int


class UnsolicitedError(NamedTuple):
    """Event: an axis has sent an error reply that belongs to no request."""

    axis: int
    code: int


Happening = Reply | AxisLost | ResetDone | TwoDevices | UnexpectedMotion | UnsolicitedError


#: Commands that units execute with any data, and Restore, which units execute with data 0.
UNCONDITIONAL_COMMANDS = frozenset(
    {int(ZaberCommand.RESET), int(ZaberCommand.HOME), int(ZaberCommand.RENUMBER), int(ZaberCommand.RESTORE)}
)
FIRST_ALIAS = 192  #: alias of the first unit; no command has this number or one of the next numbers
NO_DATA = -1  #: data of commands whose data the unit ignores


def alias_number(index: int) -> int:
    """Return the alias of the unit at `index` of its chain, counted from 0."""
    return FIRST_ALIAS + index


def safe_speed(speed: int, listeners: Collection[int]) -> int:
    """Return the nearest speed that units with the numbers `listeners` cannot misread as a dangerous command.

    A unit that has lost the message boundaries interprets any six bytes in a row as a message, until the line is silent
    for 10 ms. The units execute Reset, Home and Renumber with any data. So the host avoids byte sequences that a unit
    could misread as one of these commands:

    * A query and a stop carry the data -1. Its four bytes are 255, which is neither a command nor the number of a unit.
      A speed of 0 is sent as a stop.
    * Each unit gets an alias whose number is no command. The last byte of a forward speed is 0, which addresses all
      units; the following byte is such an alias, and therefore no command.
    * The low byte of a speed is none of these commands, because a unit reads this byte as a command if the byte before
      it is lost. If the second byte of a speed is such a command, the low byte is not the number of a unit.

    One case remains: a forward speed ends with the bytes 0 0, which mean a Reset of all units. A unit that has lost
    three or four bytes since the last silence can read these bytes as a Reset. The Reset stops the motor and loses the
    position, which the driver detects. A pause after each forward speed (`LineSettings.pause`) prevents this case, too,
    but halves the rate of velocities.
    """
    if speed == 0:
        return 0
    for away in range(256):
        for near in (speed - away, speed + away) if speed > 0 else (speed + away, speed - away):
            low, high = near & 0xFF, near >> 8 & 0xFF
            if near == 0 or (
                low not in UNCONDITIONAL_COMMANDS and not (low in listeners and high in UNCONDITIONAL_COMMANDS)
            ):
                return near
    raise AssertionError(f"no speed near {speed} speed units has safe bytes")
