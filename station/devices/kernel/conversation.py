"""Requests of scripts to axes that answer each command; a lost request is repeated, a rejection raises an error."""

from collections.abc import Callable
from typing import Any

from core.errors import CtrError
from station.devices.kernel.answered import Answer, Request
from station.devices.kernel.startup import Axes, Value

MAX_ATTEMPTS = 5  #: largest number of times that a request without an answer is sent
POLL_MOTION_S = 0.05  #: interval at which the end of a motion is queried [s]


class Conversation:
    """Requests for the scripts of a protocol, which are sent again if their answer is lost."""

    def __init__(
        self, axes: Axes[Any], error: type[CtrError], reason: Callable[[str], str], fault: Callable[[str], str]
    ) -> None:
        """Create the conversation of a protocol.

        Args:
            axes: the axes.
            error: type of the protocol's errors.
            reason: returns the meaning of the code with which a device rejects a command.
            fault: returns the meaning of a flag that reports a fault; empty for any other flag.
        """
        self._axes, self._error, self._reason, self._fault = axes, error, reason, fault

    def request(self, i: int, text: str, whole_device: bool = False) -> Value[Answer]:
        """Send a request, again if its answer is lost, and return the answer; `Answer()` if none comes."""
        for _ in range(MAX_ATTEMPTS):
            answer: Answer | None = yield Request(i, text, whole_device)
            if answer is not None and answer != Answer():
                return answer
        return Answer()

    def need(self, i: int, text: str, whole_device: bool = False) -> Value[str]:
        """Send a request and return the data of its answer; raise an error unless the device accepts the request."""
        return self.accepted(i, text, (yield from self.request(i, text, whole_device)))

    def once(self, i: int, text: str) -> Value[Answer | None]:
        """Send a request to the device of axis `i` only once, and return its answer; None without an answer."""
        answer = yield Request(i, text, whole_device=True)
        return None if answer == Answer() else answer

    def accepted(self, i: int, text: str, answer: Answer) -> str:
        """Return the data of the answer to the request `text`; raise an error if it is missing or a rejection."""
        if answer == Answer():
            raise self._error(f"{self._axes.name(i)} does not answer '{text}'")
        if not answer.accepted:
            raise self._error(f"{self._axes.name(i)} rejects '{text}': {self._reason(answer.data)}")
        return answer.data

    def checked(self, i: int, text: str) -> Value[Answer]:
        """Send a request and return its answer; raise an error if the answer's flag reports a fault."""
        answer = yield from self.request(i, text)
        if fault := self._fault(answer.flag):
            raise self._error(f"{self._axes.name(i)}: {fault}")
        return answer

    def motion(self, i: int, text: str, position: str, give_up: float) -> Value[int]:
        """Start a motion, query `position` until it ends, and return the last position before its end [counts]."""
        started, last = self._axes.now, 0
        yield from self.need(i, text)
        while True:
            yield POLL_MOTION_S
            answer = yield from self.checked(i, position)
            if answer.accepted and not answer.busy:
                return last
            last = int(answer.data) if answer.accepted else last
            if self._axes.now > give_up:
                raise self._error(f"{self._axes.name(i)} has been moving for more than {give_up - started:.0f} s")
