"""ASCII protocol of Zaber A- and X-series stages with firmware 6 and 7: messages, checksums, units, warning flags.

A message is one line of text. Commands and replies carry the address of a device, the number of an axis, the ID of the
message, and a checksum. So a damaged line is dropped, and a reply is assigned to its command.
Sources: the manufacturer's ASCII Protocol Manuals for firmware 6 and 7.
"""

import math
import re
from typing import NamedTuple

from core.errors import CtrError
from station.devices.kernel.line import Unread

BAUD = 115_200  #: factory setting; 8N1 without handshake [bit/s]
BYTE_TIME_S = 10.0 / BAUD  #: transmission time of a byte [s]
SPEED_FACTOR = 1.6384  #: value of a speed in messages for 1 microstep/s: value = velocity * 1.6384 / microstep size
ACCELERATION_FACTOR = 1.6384e-4  #: value of an acceleration in messages for 1 microstep/s^2
MICROSTEP_RESOLUTION = 64  #: factory setting: microsteps per full step of the motor
MAX_POSITION = 1_000_000_000  #: largest absolute value of the settings limit.min and limit.max [microsteps]
MAX_ACCELERATION = 32_767  #: largest value of the setting accel [acceleration data]
MAX_ID = 99  #: largest message ID
MAX_LINE_BYTES = 256  #: a longer line is noise, because devices send at most 80 characters in a line


class ZaberAsciiError(CtrError):
    """A device is not the expected one, or does not execute its command."""


#: Meaning of each warning flag and what the flag requires, in the manufacturer's order: the most severe flag is first.
FAULTS = {
    "FF": "critical system error of the device",
    "FN": "the connected peripheral is not supported",
    "FZ": "the peripheral is inactive and must be activated",
    "FH": "the hardware emergency stop is pressed, the motor has no current",
    "FV": "the supply voltage is too high or too low, the motor has no current",
    "FO": "the motor has no current: it was never switched on, or a command has switched it off",
    "FC": "the current at switching on was too high",
    "FM": "the motor is too hot",
    "FD": "the driver has disabled itself, usually by overheating",
    "FQ": "the encoder's signal is invalid",
    "FI": "the encoder's index mark is wrong",
    "FA": "the analog encoder has lost its synchronisation",
    "FR": "the motor was overdriven for too long",
    "FS": "the motor stalled and has stopped",
    "FB": "a stream's motion would leave the travel",
    "FP": "the stage has left its interpolated path",
    "FE": "the limit sensor cannot be reached or does not work",
    "FT": "the stages of a lockstep group are twisted",
}
WARNINGS = {
    "WL": "a limit sensor was triggered where none is expected: the position may be wrong",
    "WV": "the supply voltage is out of range",
    "WT": "the controller is hot",
    "WS": "the motor stalled and has recovered: the position may be wrong",
    "WM": "the stage was moved while it was stationary",
    "WP": "the calibration type is invalid",
    "WR": "the stage has no reference position and must be homed",
    "WH": "the stage is not homed",
}
NOTES = {
    "NC": "the stage is moved by its knob",
    "NI": "a command has interrupted a motion",
    "ND": "a stream has stopped for lack of commands",
    "NR": "a value was rounded",
    "NT": "a value was truncated",
    "NU": "a changed setting is not active yet",
    "NJ": "the joystick is calibrating",
    "NB": "the device is in firmware update mode",
}
FLAGS = {**FAULTS, **WARNINGS, **NOTES}
NO_FLAG = "--"
#: Flags of a stage that must be homed.
NOT_HOMED = frozenset({"WR", "WH"})
#: Flags that the driver causes itself: it interrupts each velocity by the next one.
EXPECTED = frozenset({NO_FLAG, "NI", "NR", "NT", "NU"})


def flag_text(flag: str) -> str:
    """Return a warning flag with its meaning."""
    return f"{FLAGS.get(flag, 'a flag that the manual does not list')} (flag {flag})"


def fault_text(flag: str) -> str:
    """Return a fault's flag with its meaning; empty for any other flag."""
    return flag_text(flag) if flag in FAULTS else ""


#: Meaning of the reasons with which a device rejects a command.
REASONS = {
    "AGAIN": "the command cannot be processed right now",
    "BADAXIS": "the device has no axis of that number",
    "BADCOMMAND": "the device does not know the command or setting",
    "BADDATA": "the value is out of range",
    "BADMESSAGEID": "the message ID is out of range",
    "DEVICEONLY": "the command is for the whole device, not for an axis",
    "DRIVERDISABLED": "the motor has no current",
    "FULL": "the device has no room for more",
    "LOCKSTEP": "the axis belongs to a lockstep group",
    "NOACCESS": "the access level of the device does not permit it",
    "PARKED": "the axis is parked",
    "STATUSBUSY": "the axis is moving",
}


def reason_text(reason: str) -> str:
    """Return the reason of a rejection with its meaning."""
    return f"{REASONS.get(reason, 'rejected')} ({reason})"


class Reply(NamedTuple):
    """A device's answer to a command."""

    device: int
    axis: int  #: 0: the whole device
    identity: int | None  #: message ID of the command; None: the command had none
    accepted: bool
    busy: bool  #: whether an addressed axis moves
    flag: str  #: most severe warning flag, or `NO_FLAG`
    data: str  #: value, or the reason of a rejection


class Alert(NamedTuple):
    """A message that a device sends without a command, at the end of a motion or with a new warning."""

    device: int
    axis: int
    busy: bool
    flag: str


def checksum(body: bytes) -> int:
    """Return the longitudinal redundancy check of a line without its first character and without the checksum."""
    return -sum(body) & 0xFF


def encode(device: int, axis: int, identity: int, text: str) -> bytes:
    """Return the line of a command; device 0 addresses all devices, axis 0 all axes.

    Devices accept lines without a checksum. If the colon is lost, the space before it keeps the checksum's digits apart
    from a number: the device then rejects the command instead of moving 100 times as fast.
    """
    body = f"{device:02} {axis} {identity:02} {text} ".encode("ascii")
    return b"/%s:%02X\n" % (body, checksum(body))


def speed_data(microsteps_per_s: float) -> int:
    """Return a speed as `move vel` carries it; raises ZaberAsciiError if it is not finite."""
    if not math.isfinite(microsteps_per_s):
        raise ZaberAsciiError(f"speed {microsteps_per_s} microsteps/s is not finite")
    return round(microsteps_per_s * SPEED_FACTOR)


_REPLY = re.compile(r"@(\d\d) (\d)(?: (\d\d))? (OK|RJ) (IDLE|BUSY) (--|[A-Z]{2}) ?([!-9;-~][ -9;-~]*)?")
_ALERT = re.compile(r"!(\d\d) (\d) (IDLE|BUSY) (--|[A-Z]{2})(?: [ -9;-~]*)?")


def decode(line: bytes, checked: bool) -> Reply | Alert | None:
    """Return the message in a line without its line end; None if the line is damaged or carries information only.

    `checked`: accept only lines with a checksum.
    """
    body, colon, sent = line.partition(b":")
    if colon and sent != b"%02X" % checksum(body[1:]):
        return None
    if checked and not colon:
        return None
    text = body.decode("ascii", "replace")
    if found := _REPLY.fullmatch(text):
        device, axis, identity, accepted, busy, flag, data = found.groups()
        number = None if identity is None else int(identity)
        return Reply(int(device), int(axis), number, accepted == "OK", busy == "BUSY", flag, data or "")
    if found := _ALERT.fullmatch(text):
        device, axis, busy, flag = found.groups()
        return Alert(int(device), int(axis), busy == "BUSY", flag)
    return None


class LineReader:
    """Extracts messages from a byte stream that may be split anywhere, damaged or noisy."""

    def __init__(self) -> None:
        self.checked = False  #: whether lines without a checksum are dropped
        self.dropped = Unread()  #: bytes of lines that are no message
        self._rest = b""

    @property
    def unread(self) -> bytes:
        """Newest bytes that belong to no message."""
        return self.dropped.last + (b"" if self._rest.startswith((b"@", b"!", b"#")) else self._rest)

    def feed(self, data: bytes) -> list[Reply | Alert]:
        """Return the messages that `data` completes."""
        if not data:
            return []
        messages: list[Reply | Alert] = []
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        for line in filter(None, lines):
            # If a line end was lost, the last message of the joined lines is still complete.
            start = max(line.rfind(start) for start in (b"@", b"!", b"#"))
            message = None if start < 0 else decode(line[start:], self.checked)
            if message is not None:
                messages.append(message)
            elif not line.startswith(b"#"):
                self.dropped.add(line)
        if len(self._rest) > MAX_LINE_BYTES:
            self.dropped.add(self._rest)
            self._rest = b""
        return messages
