"""Time as a parameter: virtual time runs as fast as the machine, real time keeps absolute deadlines."""

import time
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
