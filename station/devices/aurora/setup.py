"""Set-up of an Aurora: finds the unit's baud rate, reads the unit's identity, and enables the tools."""

import re
from collections.abc import Generator

from station.devices.aurora.dialogue import (
    AuroraRequest,
    Dialogue,
    Pause,
    RateChange,
    Reply,
    Script,
    SerialBreak,
    is_okay,
)
from station.devices.aurora.protocol import BAUD_CODES, POWER_UP_BAUD, AuroraError
from station.devices.aurora.replies import NOT_IN_THIS_MODE, error_code, error_words, parse_phinf, parse_phsr

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
                reply = yield from dialogue.query("INIT:", is_okay, settings.reply_timeout, 2)
                if error_code(str(reply)) == NOT_IN_THIS_MODE:
                    yield from dialogue.command("TSTOP:", settings.reply_timeout)
                    yield from dialogue.command("INIT:", settings.reply_timeout)
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
        yield AuroraRequest("", lambda text: text == "RESET", settings.reset_wait)


def _change_rate(dialogue: Dialogue) -> Script:
    command = f"COMM:{BAUD_CODES[dialogue.settings.baud]}0000"
    # Sent only once: without a reply the unit's baud rate is unknown, and `find_unit` tries both rates again.
    reply = yield AuroraRequest(command, is_okay, dialogue.settings.reply_timeout)
    code = error_code(str(reply))
    if reply is None or code is not None:
        raise AuroraError(f"{command}: {'no answer' if code is None else error_words(code)}")
    yield Pause(dialogue.now + dialogue.settings.switch_wait)
    yield RateChange(dialogue.settings.baud)
    return reply


def identify(dialogue: Dialogue) -> Script:
    """Read the firmware version, which selects BX or TX."""
    version = yield from dialogue.query("VER:0", lambda text: not is_okay(text), dialogue.settings.reply_timeout)
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
            yield from dialogue.query(f"PHF:{handle:02X}", is_okay, settings.reply_timeout)
        for command in ("PINIT:{:02X}", "PENA:{:02X}D"):
            for handle in (yield from _handles(dialogue, "02" if command.startswith("PINIT") else "03")):
                reply = yield from dialogue.query(command.format(handle), is_okay, settings.tool_timeout)
                code = error_code(str(reply))
                if code is not None:
                    refused = f"{command.format(handle)}: {error_words(code)}"
        dialogue.tools = {}
        for handle in (yield from _handles(dialogue, "04")):
            reply = yield from dialogue.query(f"PHINF:{handle:02X}0001", _is_phinf, settings.reply_timeout)
            identity = None if error_code(str(reply)) is not None else parse_phinf(str(reply))
            if identity is not None:
                dialogue.tools[handle] = identity
        dialogue.target = next(
            (
                h
                for h, tool in dialogue.tools.items()
                if settings.target_serial and tool.serial == settings.target_serial
            ),
            None,
        )
        candidates = [
            h
            for h, tool in dialogue.tools.items()
            if settings.tool_serial in ("", tool.serial) and h != dialogue.target
        ]
        if candidates:
            dialogue.handle = min(candidates)
            return None
        present = ", ".join(tool.serial for tool in dialogue.tools.values()) or "none"
        missing = f"tool {settings.tool_serial}" if settings.tool_serial else "a tool"
        dialogue.trouble = refused or f"{missing} is not plugged in; connected tools: {present}"
        yield Pause(dialogue.now + settings.retry_wait)


def _handles(
    dialogue: Dialogue, which: str
) -> Generator[RateChange | SerialBreak | Pause | AuroraRequest, Reply, list[int]]:
    reply = yield from dialogue.query(f"PHSR:{which}", _is_phsr, dialogue.settings.reply_timeout)
    code = error_code(str(reply))
    if code is not None:
        raise AuroraError(f"PHSR:{which}: {error_words(code)}")
    return [handle for handle, _ in parse_phsr(str(reply))]


def _is_phsr(text: str) -> bool:
    return re.fullmatch(r"(?:[0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{5})*", text) is not None


def _is_phinf(text: str) -> bool:
    return len(text) == 33 or text == "UNOCCUPIED"
