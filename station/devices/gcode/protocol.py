"""Lines of G-code boards: commands, checksums, replies, and the meanings of their numbers; GRBL 1.1 and Marlin 2.

Sources: the wikis of GRBL 1.1 (interface, jogging, CSV tables of errors and alarms) and the G-code pages of Marlin.
"""

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from core.errors import CtrError
from station.devices.kernel.line import KEPT_BYTES

Dialect = Literal["grbl", "marlin"]
BAUDS: dict[Dialect, int] = {"grbl": 115200, "marlin": 250000}
LETTERS = "XYZABC"  #: usual order of the axes in GRBL's positions and settings
MAX_LINE_BYTES = 256  #: longest line of a board that is processed
#: GRBL's bytes that act at once: jog cancel, feed hold, end of a hold, status query, soft reset, feed of 100 %.
JOG_CANCEL, HOLD, RESUME, QUERY, RESET, FULL_FEED = b"\x85", b"!", b"~", b"?", b"\x18", b"\x90"

GRBL_ERRORS = {
    1: "a G-code word has no letter",
    2: "a number is missing or invalid",
    3: "the firmware does not know this $ command",
    4: "a value must not be negative",
    5: "homing is not enabled ($22)",
    7: "the settings in the board's memory were lost",
    8: "this $ command needs an idle board",
    9: "the board is locked by an alarm or a jog",
    10: "soft limits need homing ($20, $22)",
    11: "the line is too long",
    15: "the target is outside the board's travel ($130 to $132)",
    16: "the jog command is invalid",
    18: "the board's reset input is active",
    20: "the firmware does not know this G-code",
    22: "the feed rate is missing",
    30: "G53 needs G0 or G1",
    33: "the target is invalid",
    36: "a word of the line is not used by its command",
    37: "G43.1 does not apply to this axis",
    45: "a limit switch is pressed: move the axis away from it",
    46: "the board must be homed",
    50: "the emergency stop is active: release it",
    79: "the emergency stop is active: release it",
    152: "the configuration of FluidNC is invalid: read the messages of its start",
}
GRBL_ALARMS = {
    1: "a limit switch was hit, the position is lost",
    2: "the target is outside the board's travel",
    3: "reset during a motion, the position is lost",
    4: "the probe is not in its initial state",
    5: "the probe touched nothing",
    6: "homing was reset",
    7: "the safety door was opened during homing",
    8: "homing could not leave the limit switch",
    9: "homing did not find the limit switch",
    10: "the emergency stop is active: release it",
    11: "the board must be homed",
    12: "a limit switch is pressed: move the axis away from it",
    16: "the board's self-test failed",
    17: "the driver of a motor reports a fault: switch the board off and on, and check the motor's cable",
}
#: Alarms that have another meaning in FluidNC (`ExecAlarm`).
FLUIDNC_ALARMS = {
    10: "the spindle does not follow",
    11: "an input is active that must not be: check switches and buttons",
    12: "home switches of both ends are pressed",
    13: "hard stop",
    14: "the board must be homed",
    15: "the board has just started",
    16: "the board's expander has restarted",
    17: "a line of a file was rejected",
    18: "a limit switch was hit by the probe",
}
#: Alarms of grblHAL that end only when their cause is removed.
LASTING_ALARMS = (10, 16, 17)


class GcodeError(CtrError):
    """A board cannot be used; the text names the cause and what to do."""


class Ok(NamedTuple):
    """A line was accepted."""


class Failure(NamedTuple):
    """A line was rejected; `text` is the meaning."""

    text: str


class Position(NamedTuple):
    """Position of every axis."""

    values: tuple[float, ...]  #: GRBL: machine position [unit]; Marlin: [steps]
    state: str = ""  #: GRBL's state, such as Idle, Jog, Alarm
    logical: tuple[float, ...] = ()  #: Marlin: position with work offsets [unit]
    code: int = 0  #: GRBL's number behind the state, such as that of an alarm
    pendant: bool | None = None  #: grblHAL: whether a pendant has the control; None: not reported, so unchanged
    work: bool = False  #: GRBL: whether `values` are work positions, or positions of axes in an unknown order


class Alarm(NamedTuple):
    """The board has locked itself; `text` is the meaning."""

    text: str
    number: int = 0  #: number of GRBL's alarm


class Started(NamedTuple):
    """The board has restarted."""

    banner: str


class Resend(NamedTuple):
    """Marlin has not received the line of this number."""

    number: int


class Busy(NamedTuple):
    """Marlin is executing a long command."""


class Info(NamedTuple):
    """Any other line."""

    text: str


Message = Ok | Failure | Position | Alarm | Started | Resend | Busy | Info

#: Each firmware prints a fixed number of decimals and no leading zeros, so most lost characters are detected.
_WHOLE = r"-?(?:0|[1-9]\d{0,8})"
_GRBL_STATUS = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep|Tool)(?::(\d{1,2}))?"
    rf"\|([MW])Pos:({_WHOLE}\.\d{{3}}(?:,{_WHOLE}\.\d{{3}})*)"
    r"(?:\|(?:Bf|Ln):[\d,]+)*\|FS?:\d+(?:\.\d)?(?:,\d+)*(?:\|[A-Z][A-Za-z]*:[-\w.,/ ]*)*>"
)
_MARLIN_POSITION = re.compile(rf"((?:[A-Z]:{_WHOLE}\.\d\d )+)Count ([A-Z]:{_WHOLE}(?: [A-Z]:{_WHOLE})*)")


def error_text(number: int) -> str:
    """Return the meaning of a GRBL error."""
    return f"{GRBL_ERRORS.get(number, 'see the table of GRBL errors')} (error:{number})"


def alarm_text(number: int, fluidnc: bool = False) -> str:
    """Return the meaning of an alarm of GRBL or FluidNC."""
    meanings = {**GRBL_ALARMS, **FLUIDNC_ALARMS} if fluidnc else GRBL_ALARMS
    return f"{meanings.get(number, 'see the table of GRBL alarms')} (ALARM:{number})"


def numbered(number: int, text: str) -> bytes:
    """Return a Marlin line with its number and checksum."""
    line = f"N{number} {text}"
    check = 0
    for byte in line.encode("ascii"):
        check ^= byte
    return f"{line}*{check}\n".encode("ascii")


def parse(dialect: Dialect, line: str, letters: Sequence[str], order: str = LETTERS) -> Message:
    """Return the meaning of one line.

    Args:
        dialect, line: firmware of the board, and a line that the board has sent.
        letters: letters of the axes that are used.
        order: letters of all axes of GRBL; empty: unknown, so positions only show whether the axes move.
    """
    if line == "ok" or (dialect == "marlin" and re.fullmatch(r"ok( [NPBT]-?\d+)*", line)):
        return Ok()
    return _parse_grbl(line, letters, order) if dialect == "grbl" else _parse_marlin(line, letters)


def _parse_grbl(line: str, letters: Sequence[str], order: str) -> Message:
    if match := re.fullmatch(r"(error|ALARM):(\d{1,3})", line):
        number = int(match[2])
        return Failure(error_text(number)) if match[1] == "error" else Alarm(alarm_text(number), number)
    if line.startswith(("Grbl ", "GrblHAL ")) and line.endswith("]"):
        return Started(line)
    if match := _GRBL_STATUS.fullmatch(line):
        values = dict(zip(order or letters, map(float, match[4].split(",")), strict=False))
        if all(letter in values for letter in letters):
            used = tuple(values[letter] for letter in letters)
            pendant = None if "|MPG:" not in line else "|MPG:1" in line
            return Position(used, match[1], (), int(match[2] or 0), pendant, match[3] == "W" or not order)
    return Info(line)


def _parse_marlin(line: str, letters: Sequence[str]) -> Message:
    if match := re.fullmatch(r"Resend: ?(\d{1,9})", line):
        return Resend(int(match[1]))
    if line == "start":
        return Started(line)
    if line.startswith("echo:busy:"):
        return Busy()
    if line.startswith("Error:"):
        text = line.removeprefix("Error:").strip()
        return Alarm(text) if "halted" in text or "kill" in text else Failure(text)
    if match := _MARLIN_POSITION.fullmatch(line):
        words = [[(w[0], float(w[2:])) for w in match[k].split()] for k in (1, 2)]
        names = [[letter for letter, _ in part if letter != "E"] for part in words]
        logical, steps = map(dict, words)
        if names[0] == names[1] and len(steps) == len(names[1]) and set(letters) <= set(names[1]):
            return Position(tuple(steps[c] for c in letters), "", tuple(logical[c] for c in letters))
    return Info(line)


def setting(line: str) -> tuple[int, float] | None:
    """Return number and value in a line of GRBL's `$$`, also with grblHAL's explanation; None: no such line."""
    match = re.fullmatch(r"\$(\d+) ?= ?(-?\d+(?:\.\d*)?)(?: *\(.*)?", line)
    return None if match is None else (int(match[1]), float(match[2]))


class LineReader:
    """Splits received bytes into lines; drops lines that are too long or not ASCII."""

    def __init__(self) -> None:
        self.dropped = 0  #: bytes that were dropped
        self.last = b""  #: last bytes that were received
        self._part = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the complete lines without white space at their ends."""
        self.last = (self.last + data)[-KEPT_BYTES:]
        *lines, self._part = (self._part + data).replace(b"\r", b"\n").split(b"\n")
        if len(self._part) > MAX_LINE_BYTES:
            self.dropped += len(self._part)
            self._part = b""
        good: list[str] = []
        for line in lines:
            if not line.isascii() or len(line) > MAX_LINE_BYTES:
                self.dropped += len(line)
            elif text := line.decode("ascii").strip():
                good.append(text)
        return good
