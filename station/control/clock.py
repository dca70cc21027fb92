"""Clocks that pace the control loop: virtual time never waits, and real time keeps absolute deadlines.

All processes of a live station share one `StationClock`, which may be slower than real time.
"""

import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """Clock that paces the ticks of the control loop."""

    def wait_until(self, due: float) -> None:
        """Wait until `due` [s], counted from the start."""
        ...


class VirtualClock:
    """Clock of virtual time: it never waits, so ticks follow each other as fast as the computer allows."""

    def wait_until(self, due: float) -> None:
        """Return at once, because virtual time never waits."""


class RealClock:
    """Clock of real time, which starts with the first wait."""

    def __init__(self) -> None:
        self._start: float | None = None

    def wait_until(self, due: float) -> None:
        """Sleep until `due` [s]; deadlines are absolute, so that the delays of single ticks do not add up."""
        if self._start is None:
            self._start = time.perf_counter() - due
        left = self._start + due - time.perf_counter()
        if left > 0.0:
            time.sleep(left)


@dataclass(frozen=True)
class StationClock:
    """Clock of a live station, which shows the same time in every process of the computer."""

    rate: float = 1.0  #: station seconds per real second
    #: Longest silence of simulated stages and force sensors before they count as lost [s]; a tracker may be silent as
    #: long, and at least for its default. A busy computer delays the replies of simulated devices but loses none.
    patience: float = 0.15

    def now(self) -> float:
        """Return the monotonic time since an origin that all processes share [s]."""
        return self.rate * time.monotonic()

    def real(self, seconds: float) -> float:
        """Convert `seconds` of the station's clock to real time [s]."""
        return seconds / self.rate

    def sleep(self, seconds: float) -> None:
        """Sleep for `seconds` of the station's clock."""
        time.sleep(seconds / self.rate)


REAL_TIME_CLOCK = StationClock()
