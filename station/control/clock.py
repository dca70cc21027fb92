"""Time as a parameter: virtual time runs as fast as the machine, real time keeps absolute deadlines.

A live station has a time of its own, one for all its processes, which may be slower than real time.
"""

import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """Says when a tick may begin."""

    def wait_until(self, due: float) -> None:
        """Return when `due` [s] since the start has come."""
        ...


class VirtualClock:
    """Never waits."""

    def wait_until(self, due: float) -> None:
        """Return at once."""


class RealClock:
    """Wall time since the first wait."""

    def __init__(self) -> None:
        self._start: float | None = None

    def wait_until(self, due: float) -> None:
        """Sleep until the deadline; the deadlines are absolute, so that lateness does not add up."""
        if self._start is None:
            self._start = time.perf_counter() - due
        left = self._start + due - time.perf_counter()
        if left > 0.0:
            time.sleep(left)


@dataclass(frozen=True)
class StationClock:
    """The time of a live station: the same in every process of a computer."""

    rate: float = 1.0  #: seconds of the station in a second
    #: What a simulated device's word may take [s]. Real ones have processors of their own: a busy computer makes these
    #: late and not lost.
    patience: float = 0.15

    def now(self) -> float:
        """Since a moment that all processes share [s]; never goes back."""
        return self.rate * time.monotonic()

    def real(self, seconds: float) -> float:
        """How long so many seconds of the station last [s]."""
        return seconds / self.rate

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds of the station."""
        time.sleep(seconds / self.rate)


REAL_TIME = StationClock()
