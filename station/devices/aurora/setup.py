"""Setting an Aurora up: finding it at whatever rate it talks, who it is, and its tools ready to be tracked."""

import re
from collections.abc import Generator

from station.devices.aurora.dialogue import Ask, Break, Dialogue, Pause, Rate, Reply, Script, is_okay
from station.devices.aurora.protocol import BAUD_CODES, POWER_UP_BAUD, AuroraError
from station.devices.aurora.replies import NOT_IN_THIS_MODE, error_code, error_words, parse_phinf, parse_phsr

BREAK = 0.25  #: that the line is held low [s]
#: Firmware that has no usable BX (a public Aurora client's list).
NEEDS_TX = ("AURORA Rev 007", "AURORA Rev 008")


def contact(talk: Dialogue) -> Script:
    """Find the unit at 9600 baud or where another session left it, and talk fast from then on."""
    settings = talk.settings
    while True:
        for baud in dict.fromkeys((POWER_UP_BAUD, settings.baud)):
            yield Rate(baud)
            try:
                reply = yield from talk.ask("INIT:", is_okay, settings.reply_timeout, 2)
                if error_code(str(reply)) == NOT_IN_THIS_MODE:
                    yield from talk.command("TSTOP:", settings.reply_timeout)
                    yield from talk.command("INIT:", settings.reply_timeout)
                elif error_code(str(reply)) is not None:
                    continue
            except AuroraError as error:
                talk.trouble = str(error)
                continue
            if baud != settings.baud:
                yield from _change_rate(talk)
            return None
        yield Rate(POWER_UP_BAUD)
        yield Break(True)
        yield Pause(talk.now + BREAK)
        yield Break(False)
        yield Ask("", lambda text: text == "RESET", settings.reset_wait)


def _change_rate(talk: Dialogue) -> Script:
    command = f"COMM:{BAUD_CODES[talk.settings.baud]}0000"
    # Asked once: without an answer it may have changed or not, and is looked for at both rates.
    reply = yield Ask(command, is_okay, talk.settings.reply_timeout)
    code = error_code(str(reply))
    if reply is None or code is not None:
        raise AuroraError(f"{command}: {'no answer' if code is None else error_words(code)}")
    yield Pause(talk.now + talk.settings.switch_wait)
    yield Rate(talk.settings.baud)
    return reply


def identify(talk: Dialogue) -> Script:
    """Read the firmware, which decides between BX and TX."""
    version = yield from talk.ask("VER:0", lambda text: not is_okay(text), talk.settings.reply_timeout)
    tag = re.search(r"^Freeze Tag:\s*(.*?)\s*$", str(version), re.MULTILINE)
    talk.firmware = tag[1] if tag else ""
    talk.tx = talk.settings.always_tx or talk.firmware in NEEDS_TX
    return version


def prepare_tools(talk: Dialogue) -> Script:
    """Initialise and enable what is plugged in, until the coil at the tip is among it."""
    settings = talk.settings
    while True:
        refused = ""
        for handle in (yield from _handles(talk, "01")):
            yield from talk.ask(f"PHF:{handle:02X}", is_okay, settings.reply_timeout)
        for command in ("PINIT:{:02X}", "PENA:{:02X}D"):
            for handle in (yield from _handles(talk, "02" if command.startswith("PINIT") else "03")):
                reply = yield from talk.ask(command.format(handle), is_okay, settings.tool_timeout)
                code = error_code(str(reply))
                if code is not None:
                    refused = f"{command.format(handle)}: {error_words(code)}"
        talk.tools = {}
        for handle in (yield from _handles(talk, "04")):
            reply = yield from talk.ask(f"PHINF:{handle:02X}0001", _is_phinf, settings.reply_timeout)
            identity = None if error_code(str(reply)) is not None else parse_phinf(str(reply))
            if identity is not None:
                talk.tools[handle] = identity
        talk.target = next(
            (h for h, tool in talk.tools.items() if settings.target_serial and tool.serial == settings.target_serial),
            None,
        )
        mine = [h for h, tool in talk.tools.items() if settings.tool_serial in ("", tool.serial) and h != talk.target]
        if mine:
            talk.handle = min(mine)
            return None
        there = ", ".join(tool.serial for tool in talk.tools.values()) or "none"
        wanted = f"tool {settings.tool_serial}" if settings.tool_serial else "a tool"
        talk.trouble = refused or f"{wanted} is not plugged in; tools that are: {there}"
        yield Pause(talk.now + settings.retry_wait)


def _handles(talk: Dialogue, which: str) -> Generator[Rate | Break | Pause | Ask, Reply, list[int]]:
    reply = yield from talk.ask(f"PHSR:{which}", _is_phsr, talk.settings.reply_timeout)
    code = error_code(str(reply))
    if code is not None:
        raise AuroraError(f"PHSR:{which}: {error_words(code)}")
    return [handle for handle, _ in parse_phsr(str(reply))]


def _is_phsr(text: str) -> bool:
    return re.fullmatch(r"(?:[0-9A-Fa-f]{2})(?:[0-9A-Fa-f]{5})*", text) is not None


def _is_phinf(text: str) -> bool:
    return len(text) == 33 or text == "UNOCCUPIED"
