"""Talking with an Aurora as a script: its steps, its orders to the port, and a question asked until it is answered.

A script is a generator that yields what to send or to wait for and is sent the replies, so that the
conversation reads in the order in which it happens. Whoever runs it knows the time and has the port.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple

from station.devices.aurora.protocol import POWER_UP_BAUD, AuroraError
from station.devices.aurora.replies import FrameReply, ToolIdentity, error_code, error_words
from station.devices.aurora.settings import AuroraSettings

#: Errors that a disturbed line makes out of a good command: ask again.
DISTURBED = (0x01, 0x02, 0x03, 0x04, 0x05)


class Rate(NamedTuple):
    """Order to the port: talk at this rate from now on [bit/s]."""

    baud: int


class Break(NamedTuple):
    """Order to the port: hold the line low, or let it go again; a while of that resets the unit to 9600 baud."""

    low: bool


class Pause(NamedTuple):
    """Step of the script: let time pass."""

    until: float  #: [s]


class Ask(NamedTuple):
    """Step of the script: send a command, unless it is empty, and wait for its answer."""

    command: str
    answers: Callable[[str], bool] | None  #: whether a text is the answer; None: a frame is
    timeout: float


Reply = str | FrameReply | None
Script = Generator[Rate | Break | Pause | Ask, Reply, Reply]


def is_okay(text: str) -> bool:
    """Whether a command was carried out, perhaps with a warning."""
    return text == "OKAY" or text.startswith("WARNING")


class Dialogue:
    """One conversation: what was found out of the unit so far, and how to ask for more."""

    def __init__(self, settings: AuroraSettings) -> None:
        self.settings = settings
        self.now = 0.0  #: kept by whoever runs the script [s]
        self.baud = POWER_UP_BAUD  #: that is talked at; kept by whoever runs the script
        self.tx = settings.always_tx  #: whether frames are asked for by TX
        self.trouble = ""  #: what keeps the unit from tracking, in words; empty when nothing does
        self.firmware = ""  #: the unit's freeze tag
        self.tools: dict[int, ToolIdentity] = {}  #: by handle
        self.handle: int | None = None  #: of the coil at the tip
        self.target: int | None = None  #: handle of the target's coil; None while it is not plugged in

    def ask(self, command: str, answers: Callable[[str], bool], timeout: float, tries: int = 3) -> Script:
        """Ask, again if need be; the text of the answer, perhaps an ERROR."""
        reply: Reply = None
        for attempt in range(tries):
            reply = yield Ask(command, answers, timeout)
            failed = not isinstance(reply, str) or error_code(reply) in DISTURBED
            if failed or attempt:
                yield Pause(self.now + self.settings.quiet)
            if not failed:
                return reply
        if isinstance(reply, str):
            return reply
        raise AuroraError(f"no answer to {command} within {tries} times {timeout:g} s at {self.baud} baud")

    def command(self, command: str, timeout: float) -> Script:
        """Ask for OKAY.

        Raises:
            AuroraError: it was refused.
        """
        reply = yield from self.ask(command, is_okay, timeout)
        code = error_code(str(reply))
        if code is not None:
            raise AuroraError(f"{command}: {error_words(code)}")
        return reply
