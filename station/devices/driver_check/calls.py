"""Calls of a driver that is checked: measures their durations, and turns an exception into a broken requirement."""

import os
from collections.abc import Callable
from contextlib import suppress
from statistics import median
from typing import Any

from core.errors import CtrError
from station.devices.driver_check.requirements import MAX_CALL_S, MAX_TYPICAL_S, Broken, Finding, Must
from station.devices.guard import GuardedDriver
from station.devices.interfaces import Clock

TICK_S = 0.002  #: time between two polls, as in the control loop [s]
#: Methods that must not wait for the device.
_QUICK = ("poll", "command", "stop", "trouble")


class Calls:
    """Calls a driver as the control loop does, and measures the duration of each call."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._longest, self._ticks = (0.0, "poll"), [0.0]
        #: File in which Linux reports how long this thread has waited for a processor; None on other systems.
        self._waits: int | None = None
        with suppress(OSError):
            self._waits = os.open("/proc/thread-self/schedstat", os.O_RDONLY)

    def guarded(self, device: Any, poll: Callable[[Any], Any]) -> Any:
        """Return a guard around a driver; `poll` checks the results of its method `poll`."""
        return GuardedDriver(device, "the driver", self._call, poll)

    def end_tick(self) -> None:
        """Wait for the next tick."""
        self._ticks.append(0.0)
        self._clock.sleep(TICK_S)

    def close(self) -> None:
        """Close the file with the waiting times of this thread."""
        if self._waits is not None:
            os.close(self._waits)
            self._waits = None

    def duration(self) -> Finding:
        """Return the finding about the duration of all calls."""
        (longest, name), usual = self._longest, median(self._ticks)
        good = usual <= MAX_TYPICAL_S and longest < MAX_CALL_S
        beyond = ", longer than a tick" if longest > TICK_S else ""
        text = f"usually {1e3 * usual:.2f} ms a tick; the longest call, `{name}`, took {1e3 * longest:.2f} ms{beyond}"
        return Finding(Must.DURATION, good, text)

    def _waited(self) -> float:
        """Return the time for which other programs have kept this thread from running [s]."""
        return 0.0 if self._waits is None else 1e-9 * int(os.pread(self._waits, 80, 0).split()[1])

    def _call(self, _: str, name: str, method: Callable[..., Any], *arguments: Any) -> Any:
        start, waited = self._clock.now(), self._waited()
        try:
            return method(*arguments)
        except (Exception, SystemExit) as error:  # a foreign driver can raise anything
            if name == "home" and isinstance(error, CtrError):
                raise  # stages may refuse to home
            raise Broken(Must.NO_EXCEPTIONS, f"{name} raised {type(error).__name__}: {error}") from error
        finally:
            if name in _QUICK:
                took = max(0.0, self._clock.now() - start - (self._waited() - waited))
                self._longest = max(self._longest, (took, name))
                self._ticks[-1] += took
