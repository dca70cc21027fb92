"""Runs a script of requests and waiting times, such as the connecting or homing of stages, without blocking."""

from collections.abc import Generator
from typing import Generic, TypeVar

from core.errors import CtrError

Request = TypeVar("Request")
Answer = TypeVar("Answer")


class ScriptRunner(Generic[Request, Answer]):
    """Runs one script at a time: a generator that yields requests or waiting times [s], and receives answers."""

    def __init__(self) -> None:
        self.failure = ""  #: why the last script ended early; "" if it completed
        self._steps: Generator[Request | float, Answer | None, None] | None = None
        self._wait_until: float | None = None  # end of a waiting time [s]; None: the script waits for an answer

    @property
    def running(self) -> bool:
        """Whether a script is running."""
        return self._steps is not None

    def start(self, steps: Generator[Request | float, Answer | None, None], now: float) -> None:
        """Start a script at `now` [s], and end the running one."""
        self.end()
        self.failure, self._steps, self._wait_until = "", steps, now

    def end(self) -> None:
        """End the running script early."""
        if self._steps is not None:
            self._steps.close()
            self._steps = None

    def advance(self, now: float, answer: Answer | None = None) -> Request | None:
        """Continue after an `answer`, or at `now` [s] after a waiting time; return the next request to send."""
        if self._steps is None or (answer is None and (self._wait_until is None or now < self._wait_until)):
            return None
        try:
            step = self._steps.send(answer)
        except StopIteration:
            self._steps = None
        except CtrError as error:
            self._steps, self.failure = None, str(error)
        else:
            if not isinstance(step, float | int):
                self._wait_until = None
                return step
            self._wait_until = now + step
        return None
