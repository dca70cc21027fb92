"""Scripted communication with an Aurora: steps of a script, commands to the port, and requests with repetitions.

A script is a generator. It yields steps (send a request, wait, change the port) and receives the replies. The order of
its code is therefore the order of the communication. The caller that runs a script provides the time and the port.
"""

import re
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import NamedTuple

from station.devices.aurora.protocol import (
    BAUD_CODES,
    NOT_IN_THIS_MODE,
    POWER_UP_BAUD,
    AuroraError,
    FrameReply,
    ToolIdentity,
    error_code,
    error_words,
    parse_phinf,
    parse_phsr,
)

# Times and limits of the communication.
REPLY_TIMEOUT_S = 0.5  #: longest wait for the reply to most commands
TOOL_TIMEOUT_S = 5.0  #: longest wait for the reply to PINIT, PENA and TSTART, which access the tool
RESET_WAIT_S = 3.0  #: longest wait for the text RESET after a break (unconfirmed)
SWITCH_WAIT_S = 0.1  #: wait after the reply to COMM until the new baud rate is used
QUIET_S = 0.1  #: wait after a failed reply, so that a late reply is not taken for the next command's reply
RETRY_WAIT_S = 1.0  #: wait from a failure to the next attempt


@dataclass(frozen=True)
class AuroraSettings:
    """Settings of one Aurora unit. Times are in seconds."""

    tool_serial: str = ""  #: serial number of the tip's coil, as PHINF reports it; empty: the tool with lowest handle
    target_serial: str = ""  #: serial number of a second coil, on the target; empty: no second coil
    baud: int = 115200  #: rate to which the driver switches; 9600 is too slow for 40 frames/s [bit/s]
    frame_rate: float = 40.0  #: frames that the unit measures per second [1/s]
    latency: float = 0.024  #: shortest time from measurement to arrival of the BX reply, 115200 baud (unconfirmed)
    always_tx: bool = False  #: request frames by TX (text) only, never by BX (binary)
    frame_timeout: float = 0.1  #: longest wait for the reply to BX and TX, plus the transmission time of the reply
    measures_axis: bool = True  #: whether the tip's direction is measured by the coil's axis; False: axis is ignored
    coil_to_tip: float = 0.0  #: distance from the coil to the robot's tip along the coil's axis [mm]
    #: Port status bits that invalidate a measurement, besides the out-of-volume bits (bits from 8 on are unconfirmed).
    fault_bits: int = 0

    def __post_init__(self) -> None:
        if self.target_serial and self.target_serial == self.tool_serial:
            raise AuroraError(
                f"Aurora: tool {self.tool_serial} cannot be the tip's coil and the target's; name another"
            )
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

    until: float  #: [s]


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
        self.now = 0.0  #: set by the caller that runs the script [s]
        self.baud = POWER_UP_BAUD  #: present rate, set by the caller that runs the script [bit/s]
        self.tx = settings.always_tx  #: whether frames are requested by TX
        self.trouble = ""  #: human-readable reason why the unit does not track; empty if it can track
        self.firmware = ""  #: the unit's freeze tag
        self.tools: dict[int, ToolIdentity] = {}  #: identities of the tools, by handle
        self.handle: int | None = None  #: handle of the coil at the tip
        self.target: int | None = None  #: handle of the target's coil; None while it is unplugged

    def query(self, command: str, answers: Callable[[str], bool], timeout: float, tries: int = 3) -> Script:
        """Send a request, repeat it if it fails, and return the text of the reply, which may be an ERROR."""
        reply: Reply = None
        for attempt in range(tries):
            reply = yield AuroraRequest(command, answers, timeout)
            failed = not isinstance(reply, str) or error_code(reply) in RETRY_ERRORS
            if failed or attempt:
                yield Pause(self.now + QUIET_S)
            if not failed:
                return reply
        if isinstance(reply, str):
            return reply
        raise AuroraError(f"no answer to {command} within {tries} times {timeout:g} s at {self.baud} baud")

    def command(self, command: str, timeout: float) -> Script:
        """Send a command and return its OKAY.

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
    while True:
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
                dialogue.trouble = str(error)
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
    """Initialise and enable the connected tools; repeat this until the tip's coil is one of the tools."""
    settings = dialogue.settings
    while True:
        refused = ""
        for handle in (yield from _handles(dialogue, "01")):
            yield from dialogue.query(f"PHF:{handle:02X}", is_okay, REPLY_TIMEOUT_S)
        for command in ("PINIT:{:02X}", "PENA:{:02X}D"):
            for handle in (yield from _handles(dialogue, "02" if command.startswith("PINIT") else "03")):
                reply = yield from dialogue.query(command.format(handle), is_okay, TOOL_TIMEOUT_S)
                code = error_code(str(reply))
                if code is not None:
                    refused = f"{command.format(handle)}: {error_words(code)}"
        dialogue.tools = {}
        for handle in (yield from _handles(dialogue, "04")):
            reply = yield from dialogue.query(f"PHINF:{handle:02X}0001", _is_phinf, REPLY_TIMEOUT_S)
            identity = None if error_code(str(reply)) is not None else parse_phinf(str(reply))
            if identity is not None:
                dialogue.tools[handle] = identity
        serials = {handle: tool.serial for handle, tool in dialogue.tools.items()}
        targets = [handle for handle, serial in serials.items() if serial == settings.target_serial != ""]
        dialogue.target = targets[0] if targets else None
        candidates = [handle for handle, serial in serials.items() if settings.tool_serial in ("", serial)]
        candidates = [handle for handle in candidates if handle != dialogue.target]
        if candidates:
            dialogue.handle = min(candidates)
            return None
        present = ", ".join(serials.values()) or "none"
        missing = f"tool {settings.tool_serial}" if settings.tool_serial else "a tool"
        dialogue.trouble = refused or f"{missing} is not plugged in; connected tools: {present}"
        yield Pause(dialogue.now + RETRY_WAIT_S)


def _handles(dialogue: Dialogue, which: str) -> Generator[Step, Reply, list[int]]:
    reply = yield from dialogue.query(f"PHSR:{which}", _is_phsr, REPLY_TIMEOUT_S)
    code = error_code(str(reply))
    if code is not None:
        raise AuroraError(f"PHSR:{which}: {error_words(code)}")
    return [handle for handle, _ in parse_phsr(str(reply))]


def _is_phsr(text: str) -> bool:
    return re.fullmatch(r"(?:[0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{5})*", text) is not None


def _is_phinf(text: str) -> bool:
    return len(text) == 33 or text == "UNOCCUPIED"
