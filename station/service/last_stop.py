"""The last stop: the stages are stopped without the control process, and everything that takes is prepared before.

When it is needed the process that drove the stages is no more, and this one may be at the end of its means. So the
driver has been loaded, and descriptors are kept for its links that nobody else can take.
"""

import contextlib
import os
import threading
from collections.abc import Mapping
from typing import Any, NamedTuple

from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.devices.interfaces import NotStopped
from station.devices.registry import emergency_stop

#: Descriptors that are kept: a few for each port, its lock and what is read to find it.
KEPT = 32


class Stopped(NamedTuple):
    """What became of the stages."""

    seen: bool  #: every axis has said that it stops, or none was ever driven
    text: str  #: in words; empty where there is nothing to say


#: Of a station that has driven no stages.
NOTHING = Stopped(True, "")


class LastStop:
    """Of the stages in `[devices.stages]`; any thread may ask, and the others wait."""

    def __init__(self, stages: Mapping[str, Any], robot: RobotFile, clock: StationClock) -> None:
        """Prepare it.

        Raises:
            ConfigError: there is no such driver, or it cannot be loaded.
        """
        self._driver, self._clock = str(stages["driver"]), clock
        self._stop = emergency_stop(stages, robot)
        self._lock = threading.Lock()
        self._kept: list[int] = []
        self._last, self._closed = NOTHING, False
        self._keep()

    def __call__(self) -> Stopped:
        """Stop them: what has been seen of that. Raises nothing; once closed it says what it saw last."""
        with self._lock:
            if not self._closed:
                self._let_go()
                self._last = self._stopped()
                self._keep()
            return self._last

    def close(self) -> None:
        """Somebody else drives the stages from now on; waits for a stop that is being made."""
        with self._lock:
            self._closed = True
            self._let_go()

    def _stopped(self) -> Stopped:
        if self._stop is None:
            return Stopped(
                False, f"driver '{self._driver}' cannot stop its stages from another process: press the emergency stop"
            )
        try:
            return Stopped(True, self._stop(self._clock))
        except NotStopped as error:
            return Stopped(False, str(error))
        except Exception as error:  # whatever an installed driver does
            how = f"{type(error).__name__} of driver '{self._driver}': {error}"
            return Stopped(False, f"the stages could not be stopped ({how}): press the emergency stop")

    def _keep(self) -> None:
        with contextlib.suppress(OSError):  # there are no more
            while len(self._kept) < KEPT:
                self._kept.append(os.open(os.devnull, os.O_RDONLY))

    def _let_go(self) -> None:
        while self._kept:
            os.close(self._kept.pop())
