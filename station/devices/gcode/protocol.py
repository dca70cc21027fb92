"""Lines of G-code boards: commands, checksums, replies, and the meanings of their numbers; GRBL 1.1 and Marlin 2.

Sources: the wikis of GRBL 1.1 (interface, jogging, CSV tables of errors and alarms) and the G-code pages of Marlin.
"""

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

from core.errors import CtrError

Dialect = Literal["grbl", "marlin"]
BAUDS: dict[Dialect, int] = {"grbl": 115200, "marlin": 250000}
MAX_LINE_BYTES = 256  #: longest line of a board that is processed
#: GRBL's bytes that act at once: jog cancel, feed hold, end of a hold, status query, soft reset.
JOG_CANCEL, HOLD, RESUME, QUERY, RESET = b"\x85", b"!", b"~", b"?", b"\x18"

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
    20: "the firmware does not know this G-code",
    22: "the feed rate is missing",
    30: "G53 needs G0 or G1",
    33: "the target is invalid",
    36: "a word of the line is not used by its command",
    37: "G43.1 does not apply to this axis",
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
}


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


class Alarm(NamedTuple):
    """The board has locked itself; `text` is the meaning."""

    text: str


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

#: Each firmware prints a fixed number of decimals and no leading zeros, so most lost characters show.
_WHOLE = r"-?(?:0|[1-9]\d{0,8})"
_GRBL_STATUS = re.compile(
    r"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep|Tool)(?::\d{1,2})?"
    rf"\|MPos:({_WHOLE}\.\d{{3}}(?:,{_WHOLE}\.\d{{3}})*)"
    r"(?:\|(?:Bf|Ln):[\d,]+)*\|FS?:\d+(?:\.\d)?(?:,\d+)*(?:\|[A-Z][A-Za-z]*:[-\w.,]*)*>"
)
_MARLIN_POSITION = re.compile(rf"((?:[A-Z]:{_WHOLE}\.\d\d )+)Count ([A-Z]:{_WHOLE}(?: [A-Z]:{_WHOLE})*)")


def error_text(number: int) -> str:
    """Return the meaning of a GRBL error."""
    return f"{GRBL_ERRORS.get(number, 'see the table of GRBL errors')} (error:{number})"


def alarm_text(number: int) -> str:
    """Return the meaning of a GRBL alarm."""
    return f"{GRBL_ALARMS.get(number, 'see the table of GRBL alarms')} (ALARM:{number})"


def numbered(number: int, text: str) -> bytes:
    """Return a Marlin line with its number and checksum."""
    line = f"N{number} {text}"
    check = 0
    for byte in line.encode("ascii"):
        check ^= byte
    return f"{line}*{check}\n".encode("ascii")


def parse(dialect: Dialect, line: str, letters: Sequence[str]) -> Message:
    """Return the meaning of one line of a board whose axes have `letters`."""
    if line == "ok" or (dialect == "marlin" and re.fullmatch(r"ok( [NPBT]-?\d+)*", line)):
        return Ok()
    return _parse_grbl(line, letters) if dialect == "grbl" else _parse_marlin(line, letters)


def _parse_grbl(line: str, letters: Sequence[str]) -> Message:
    if match := re.fullmatch(r"(error|ALARM):(\d{1,3})", line):
        number = int(match[2])
        return Failure(error_text(number)) if match[1] == "error" else Alarm(alarm_text(number))
    if line.startswith(("Grbl ", "GrblHAL ")) and line.endswith("]"):
        return Started(line)
    if match := _GRBL_STATUS.fullmatch(line):
        values = dict(zip("XYZABC", map(float, match[2].split(",")), strict=False))
        if all(letter in values for letter in letters):
            return Position(tuple(values[letter] for letter in letters), match[1])
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


class LineReader:
    """Splits received bytes into lines; drops lines that are too long or not ASCII."""

    def __init__(self) -> None:
        self.dropped = 0  #: bytes that were dropped
        self._part = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the complete lines without white space at their ends."""
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
