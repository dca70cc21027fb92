"""Scripted communication with an Aurora: steps of a script, commands to the port, and requests with repetitions.

A script is a generator. It yields steps (send a request, wait, change the port) and receives the replies. The order of
its code is therefore the order of the communication. The caller that runs a script provides the time and the port.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple

from station.devices.aurora.protocol import POWER_UP_BAUD, AuroraError
from station.devices.aurora.replies import FrameReply, ToolIdentity, error_code, error_words
from station.devices.aurora.settings import AuroraSettings

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
Script = Generator[RateChange | SerialBreak | Pause | AuroraRequest, Reply, Reply]


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
                yield Pause(self.now + self.settings.quiet)
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
