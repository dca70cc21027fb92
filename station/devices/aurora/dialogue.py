"""Scripted communication with an Aurora: steps of a script, commands to the port, and requests with repetitions.

A script is a generator. It yields steps (send a request, wait, change the port) and receives the replies. The order of
its code is therefore the order of the communication. The caller that runs a script provides the time and the port.
"""

import re
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from station.devices.aurora.protocol import (
    BAUD_CODES,
    ENABLED,
    IN_PORT,
    INITIALISED,
    NOT_IN_THIS_MODE,
    PHINF_LENGTHS,
    POWER_UP_BAUD,
    AuroraError,
    FrameReply,
    ToolIdentity,
    error_code,
    error_words,
    parse_phinf,
    parse_phsr,
)
from station.devices.kernel.quality import quoted

# Times and limits of the communication.
REPLY_TIMEOUT_S = 0.5  #: longest wait for the reply to most commands
TOOL_TIMEOUT_S = 5.0  #: longest wait for the reply to PINIT, PENA and TSTART, which access the tool
RESET_WAIT_S = 3.0  #: longest wait for the text RESET after a break (unconfirmed)
SWITCH_WAIT_S = 0.1  #: wait after the reply to COMM until the new baud rate is used
QUIET_S = 0.1  #: wait after a failed reply, so that a late reply is not mistaken for the next command's reply
RETRY_WAIT_S = 1.0  #: wait from a failure to the next attempt


class Coil(NamedTuple):
    """A coil as the station file describes it. Coils of one plug have the same serial number but different channels."""

    serial: str = ""  #: serial number, as PHINF reports it; empty: any
    port: int | None = None  #: port of its plug; None: any
    channel: int | None = None  #: channel of its plug; None: any

    @property
    def placed(self) -> bool:
        """Whether the port or the channel of the coil is specified."""
        return (self.port, self.channel) != (None, None)

    def fits(self, tool: ToolIdentity) -> bool:
        """Return whether a tool can be this coil."""
        return (
            self.serial in ("", tool.serial) and self.port in (None, tool.port) and self.channel in (None, tool.channel)
        )

    def __str__(self) -> str:
        """Return serial number, port and channel, for messages."""
        return f"{self.serial or 'no number'}{_place(self.port, self.channel)}"


ANY_COIL = Coil()


def _place(port: int | None, channel: int | None, handle: str = "") -> str:
    parts = ("" if port is None else f"port {port}", "" if channel is None else f"channel {channel}", handle)
    return f" ({text})" if (text := ", ".join(filter(None, parts))) else ""


@dataclass(frozen=True)
class AuroraSettings:
    """Settings of one Aurora unit. Times are in seconds."""

    tool: Coil = ANY_COIL  #: the tip's coil; `ANY_COIL`: the only coil that is connected
    target: Coil | None = None  #: a second coil, on the target; None: no second coil
    baud: int = 115200  #: rate to which the driver switches; 9600 is too slow for 40 frames/s [bit/s]
    frame_rate: float = 40.0  #: frames that the unit measures per second [1/s]
    latency: float = 0.024  #: shortest time from measurement to arrival of the BX reply, 115200 baud (unconfirmed)
    always_tx: bool = False  #: request frames by TX (text) only, never by BX (binary)
    frame_timeout: float = 0.1  #: longest wait for the reply to BX and TX, plus the transmission time of the reply
    measures_axis: bool = True  #: whether the tip's direction is measured by the coil's axis; False: axis is ignored
    coil_to_tip: float = 0.0  #: distance from the coil to the robot's tip along the coil's axis [mm]
    #: Further port status bits that invalidate a measurement, like the out-of-volume bits; bits from 8 on: unconfirmed.
    fault_bits: int = 0

    def __post_init__(self) -> None:
        if self.target == self.tool:
            raise AuroraError(f"Aurora: tool {self.tool} cannot be the tip's coil and the target's; change 'target'")
        if self.baud not in BAUD_CODES:
            raise AuroraError(f"Aurora: {self.baud} baud is not one of {', '.join(map(str, BAUD_CODES))}")


#: Errors that a disturbed line can cause for a correct command; the command is repeated.
RETRY_ERRORS = (0x01, 0x02, 0x03, 0x04, 0x05)


class RateChange(NamedTuple):
    """Command to the port: change the baud rate."""

    baud: int


class SerialBreak(NamedTuple):
    """Command to the port: set the line low, or release it; a long break resets the unit to 9600 baud."""

    low: bool


class Pause(NamedTuple):
    """Step of the script: wait."""

    until: float  #: time at which the script continues [s]


class AuroraRequest(NamedTuple):
    """Step of the script: send a command, unless it is empty, and wait for its reply."""

    command: str
    answers: Callable[[str], bool] | None  #: returns whether a text is the reply; None: the reply is a frame
    timeout: float  #: longest wait for the reply [s]


Reply = str | FrameReply | None
Step = RateChange | SerialBreak | Pause | AuroraRequest
Script = Generator[Step, Reply, Reply]


def is_okay(text: str) -> bool:
    """Return whether a command was executed, perhaps with a warning."""
    return text == "OKAY" or text.startswith("WARNING")


class Dialogue:
    """Communication with one unit: the known state of the unit, and methods for requests."""

    def __init__(self, settings: AuroraSettings) -> None:
        self.settings = settings
        self.now = 0.0  #: present time, set by the caller that runs the script [s]
        self.baud = POWER_UP_BAUD  #: present rate, set by the caller that runs the script [bit/s]
        self.tx = settings.always_tx  #: whether frames are requested by TX
        self.trouble = ""  #: human-readable reason why the unit does not track; empty if it can track
        self.unreadable = b""  #: newest bytes that belonged to no reply, added by the caller that runs the script
        self.firmware = ""  #: the unit's freeze tag
        self.tools: dict[int, ToolIdentity] = {}  #: identities of the enabled tools, by handle
        self.refused: list[str] = []  #: human-readable errors of the tools that cannot be enabled
        self.handle: int | None = None  #: handle of the coil at the tip
        self.target: int | None = None  #: handle of the target's coil; None while it is unplugged

    @property
    def connected(self) -> str:
        """Human-readable list of the connected tools: serial numbers with handles, and errors."""
        tools = (
            f"{tool.serial or 'no number'}{_place(tool.port, tool.channel, f'handle {handle:02X}')}"
            for handle, tool in self.tools.items()
        )
        return ", ".join([*tools, *self.refused]) or "none"

    def query(self, command: str, answers: Callable[[str], bool], timeout: float, tries: int = 3) -> Script:
        """Send a request, repeat it if it fails, and return the text of the reply, which may be an ERROR."""
        reply: Reply = None
        self.unreadable = b""
        for attempt in range(tries):
            reply = yield AuroraRequest(command, answers, timeout)
            failed = not isinstance(reply, str) or error_code(reply) in RETRY_ERRORS
            if failed or attempt:
                yield Pause(self.now + QUIET_S)
            if not failed:
                return reply
        if isinstance(reply, str):
            return reply
        if self.unreadable:
            raise AuroraError(
                f"{command} was answered by {quoted(self.unreadable)} at {self.baud} baud, which is no reply of an"
                " Aurora; check the keys 'port' and 'baud'"
            )
        raise AuroraError(f"no answer to {command} within {tries} times {timeout:g} s at {self.baud} baud")

    def command(self, command: str, timeout: float) -> Script:
        """Send a command and return the reply, which is OKAY or a warning.

        Raises:
            AuroraError: the unit refused the command.
        """
        reply = yield from self.query(command, is_okay, timeout)
        code = error_code(str(reply))
        if code is not None:
            raise AuroraError(f"{command}: {error_words(code)}")
        return reply


BREAK_S = 0.25  #: duration of the break, with the line low [s]
#: Firmware versions whose command BX is unusable (list of a public Aurora client).
TX_ONLY_FIRMWARE = ("AURORA Rev 007", "AURORA Rev 008")


def find_unit(dialogue: Dialogue) -> Script:
    """Find the unit at 9600 baud or at the rate that an earlier session set, and switch to the configured rate."""
    settings = dialogue.settings
    answered = ""  # error at the baud rate at which bytes arrived; empty: no bytes at any rate
    while True:
        before, answered = answered, ""
        for baud in dict.fromkeys((POWER_UP_BAUD, settings.baud)):
            yield RateChange(baud)
            try:
                reply = yield from dialogue.query("INIT:", is_okay, REPLY_TIMEOUT_S, 2)
                if error_code(str(reply)) == NOT_IN_THIS_MODE:
                    yield from dialogue.command("TSTOP:", REPLY_TIMEOUT_S)
                    yield from dialogue.command("INIT:", REPLY_TIMEOUT_S)
                elif error_code(str(reply)) is not None:
                    continue
            except AuroraError as error:
                answered = str(error) if dialogue.unreadable else answered
                dialogue.trouble = answered or before or str(error)
                continue
            if baud != settings.baud:
                yield from _change_rate(dialogue)
            return None
        yield RateChange(POWER_UP_BAUD)
        yield SerialBreak(True)
        yield Pause(dialogue.now + BREAK_S)
        yield SerialBreak(False)
        yield AuroraRequest("", lambda text: text == "RESET", RESET_WAIT_S)


def _change_rate(dialogue: Dialogue) -> Script:
    command = f"COMM:{BAUD_CODES[dialogue.settings.baud]}0000"
    # Sent only once: without a reply the unit's baud rate is unknown, and `find_unit` tries both rates again.
    reply = yield AuroraRequest(command, is_okay, REPLY_TIMEOUT_S)
    code = error_code(str(reply))
    if reply is None or code is not None:
        raise AuroraError(f"{command}: {'no answer' if code is None else error_words(code)}")
    yield Pause(dialogue.now + SWITCH_WAIT_S)
    yield RateChange(dialogue.settings.baud)
    return reply


def identify(dialogue: Dialogue) -> Script:
    """Read the firmware version, which selects BX or TX."""
    version = yield from dialogue.query("VER:0", lambda text: not is_okay(text), REPLY_TIMEOUT_S)
    tag = re.search(r"^Freeze Tag:\s*(.*?)\s*$", str(version), re.MULTILINE)
    dialogue.firmware = tag[1] if tag else ""
    dialogue.tx = dialogue.settings.always_tx or dialogue.firmware in TX_ONLY_FIRMWARE
    return version


def prepare_tools(dialogue: Dialogue) -> Script:
    """Initialise and enable the connected tools; repeat this until exactly one of the tools is the tip's coil."""
    settings = dialogue.settings
    while True:
        dialogue.refused, dialogue.tools = [], {}
        for handle in (yield from _handles(dialogue, "01")):
            yield from dialogue.query(f"PHF:{handle:02X}", is_okay, REPLY_TIMEOUT_S)
        tried, waiting, ports = set[int](), True, dict[int, int]()
        while waiting:  # the second coil of a plug gets its handle when the first one is initialised
            for handle in sorted((yield from _handles(dialogue, "02")).keys() - tried):
                tried.add(handle)
                yield from _prepare(dialogue, f"PINIT:{handle:02X}")
            for handle in (yield from _handles(dialogue, "03")):
                yield from _prepare(dialogue, f"PENA:{handle:02X}D")
            ports = yield from _handles(dialogue, "00")
            waiting = any(
                status & IN_PORT and not status & INITIALISED for h, status in ports.items() if h not in tried
            )
        usable = IN_PORT | ENABLED
        yield from _read_identities(dialogue, [handle for handle, bits in ports.items() if bits & usable == usable])
        targets = [] if settings.target is None else _matching(settings.target, dialogue.tools)
        tips = [handle for handle in _matching(settings.tool, dialogue.tools) if handle not in targets]
        if len(tips) == 1 and len(targets) <= 1:
            dialogue.handle, dialogue.target = tips[0], targets[0] if targets else None
            return None
        dialogue.trouble = f"{_mismatch(dialogue, tips, targets)}; connected tools: {dialogue.connected}"
        yield Pause(dialogue.now + RETRY_WAIT_S)


def _prepare(dialogue: Dialogue, command: str) -> Script:
    """Initialise or enable a tool; if the unit refuses, record the reason."""
    reply = yield from dialogue.query(command, is_okay, TOOL_TIMEOUT_S)
    code = error_code(str(reply))
    if code is not None:
        dialogue.refused.append(f"{command}: {error_words(code)}")
    return reply


def _matching(wanted: Coil, tools: Mapping[int, ToolIdentity]) -> list[int]:
    """Return the handles of the tools that can be the coil `wanted`."""
    return [handle for handle, tool in sorted(tools.items()) if wanted.fits(tool)]


def _mismatch(dialogue: Dialogue, tips: list[int], targets: list[int]) -> str:
    """Return why the handles that match the coils of the station file are not exactly one for each coil."""
    settings = dialogue.settings
    for key, coil, handles in (("target", settings.target, targets), ("tool", settings.tool, tips)):
        if len(handles) > 1 and coil and coil.serial:
            placed = any(tool.channel is not None for tool in dialogue.tools.values())
            keys = f"set '{key}_port' and '{key}_channel' to those of one, or " * placed
            return f"{len(handles)} coils have the serial number {coil.serial}: {keys}unplug all but one"
    if tips:
        return "'tool' is not set and several tools are connected: set 'tool' to the serial number of the tip's coil"
    if settings.tool == ANY_COIL:
        return "no usable tool is plugged in"
    return f"tool {settings.tool} is not plugged in, or 'tool' is wrong"


def _read_identities(dialogue: Dialogue, handles: Sequence[int]) -> Script:
    """Read the identities of tools, and their ports and channels if they are needed and the unit reports them."""
    settings, reply = dialogue.settings, ""
    for options in ("0001", "0021"):
        for handle in handles:
            reply = yield from dialogue.query(f"PHINF:{handle:02X}{options}", _is_phinf, REPLY_TIMEOUT_S)
            identity = None if error_code(str(reply)) is not None else parse_phinf(str(reply))
            if identity is not None:
                dialogue.tools[handle] = identity
        numbers = [tool.serial for tool in dialogue.tools.values()]
        if len(set(numbers)) == len(numbers) and not any(
            coil and coil.placed for coil in (settings.tool, settings.target)
        ):
            break
    return reply


def _handles(dialogue: Dialogue, which: str) -> Generator[Step, Reply, dict[int, int]]:
    reply = yield from dialogue.query(f"PHSR:{which}", _is_phsr, REPLY_TIMEOUT_S)
    code = error_code(str(reply))
    if code is not None:
        raise AuroraError(f"PHSR:{which}: {error_words(code)}")
    return dict(parse_phsr(str(reply)))


def _is_phsr(text: str) -> bool:
    return re.fullmatch(r"(?:[0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{5})*", text) is not None


def _is_phinf(text: str) -> bool:
    return len(text) in PHINF_LENGTHS or text == "UNOCCUPIED"
