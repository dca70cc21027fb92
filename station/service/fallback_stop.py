"""The fallback stop: stop the stages without the control process, with resources that are reserved in advance.

When the fallback stop is needed, the control process has ended, and this process may be out of resources. Therefore the
driver is loaded in advance, its thread is running, and file descriptors are reserved for its links.

The `emergency_stop` of a custom driver may wait forever, return nothing or end the interpreter. Therefore the call
runs in a daemon thread, every wait is bounded, and only a returned text counts as evidence of a stop.
"""

import contextlib
import os
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, NamedTuple

from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.realtime import request_fifo
from station.devices.interfaces import NotStopped
from station.devices.registry import BUILT_IN_DRIVERS, emergency_stop

#: Number of reserved file descriptors: a few for each port, for its lock file and for the files read to find the port.
RESERVED_DESCRIPTORS = 32
#: Real-time priority of the thread that stops the stages; it is below that of the control loop (50).
PRIORITY = 45
#: Largest length of a custom driver's text; the rest is cut off [characters].
MAX_TEXT = 500
PRESS = "press the emergency stop"


class StopOutcome(NamedTuple):
    """Outcome of an attempt to stop the stages."""

    confirmed: bool  #: every axis has confirmed its stop, or no axis was ever driven
    text: str  #: human-readable outcome; empty where there is nothing to report


#: Outcome for a station that has driven no stages.
NO_STAGES = StopOutcome(True, "")


class FallbackStop:
    """Fallback stop of the stages in `[devices.stages]`. It is thread-safe: threads share an attempt in progress."""

    def __init__(self, stages: Mapping[str, Any], robot: RobotFile, clock: StationClock, *, fifo: bool = False) -> None:
        """Load the driver and reserve resources; with `fifo` the thread requests real-time scheduling.

        Raises:
            ConfigError: the driver does not exist or cannot be loaded.
        """
        self._driver, self._clock, self._fifo = str(stages["driver"]), clock, fifo
        self._stop = emergency_stop(stages, robot)
        self._lock = threading.Lock()
        self._reserved: list[int] = []
        self._attempt: Future[StopOutcome] | None = None
        self._start_time = 0.0
        self._closed = False
        self._attempts = SimpleQueue[Future[StopOutcome] | None]()
        self._reserve()
        # A daemon thread: a hanging driver does not delay the interpreter's end.
        self._thread = threading.Thread(target=self._carry_out, name="fallback stop", daemon=True)
        self._thread.start()

    def begin(self) -> Future[StopOutcome]:
        """Start an attempt to stop the stages and return it, or return the attempt in progress.

        After `close` the last attempt is returned.
        """
        with self._lock:
            if self._attempt is None or (self._attempt.done() and not self._closed):
                self._attempt, self._start_time = Future(), self._clock.now()
                if self._closed:
                    self._attempt.set_result(NO_STAGES)
                else:
                    self._attempts.put(self._attempt)
            return self._attempt

    def __call__(self, patience: float) -> StopOutcome:
        """Stop the stages and return the outcome within `patience` [s]. Raises no exception."""
        return self.outcome(self.begin(), patience)

    def outcome(self, attempt: Future[StopOutcome], patience: float) -> StopOutcome:
        """Wait for the outcome of an attempt to stop the stages, at most `patience` [s], and return it."""
        try:
            return attempt.result(self._clock.real(max(0.0, patience)))
        except TimeoutError:
            lasts = self._clock.now() - self._start_time
            how = (
                f"driver '{self._driver}' has not stopped the stages; its attempt is still running after {lasts:.1f} s"
            )
            return StopOutcome(False, f"{how}: {PRESS}")

    @property
    def age(self) -> float:
        """Age of the present attempt to stop the stages [s]; 0 if no attempt is in progress."""
        under_way = self._attempt is not None and not self._attempt.done()
        return self._clock.now() - self._start_time if under_way else 0.0

    def close(self, patience: float) -> None:
        """End the thread; wait for an attempt to stop the stages until the attempt is `patience` [s] old."""
        with self._lock:
            self._closed = True
        self._attempts.put(None)
        self._thread.join(self._clock.real(max(0.0, patience - self.age)))

    def _carry_out(self) -> None:
        if self._fifo:
            request_fifo(PRIORITY)  # stopping the stages must not wait for a browser that draws the page
        while (attempt := self._attempts.get()) is not None:
            self._release()
            try:
                stopped = self._stopped()
            except BaseException:  # even the text of the driver's exception may raise
                stopped = StopOutcome(False, f"driver '{self._driver}' could not stop the stages: {PRESS}")
            self._reserve()
            attempt.set_result(stopped)
        self._release()

    def _stopped(self) -> StopOutcome:
        name = f"driver '{self._driver}'"
        if self._stop is None:
            return StopOutcome(False, f"{name} cannot stop its stages from another process: {PRESS}")
        try:
            result: Any = self._stop(self._clock)  # a custom driver may return anything
        except NotStopped as error:
            return StopOutcome(False, _shown(str(error)) or f"{name} has not stopped the stages: {PRESS}")
        except BaseException as error:  # including SystemExit and KeyboardInterrupt
            how = _shown(f"{type(error).__name__} of {name}: {error}").removesuffix(":")
            return StopOutcome(False, f"the stages could not be stopped ({how}): {PRESS}")
        text = _shown(result) if isinstance(result, str) else ""
        if not text:
            what = "an empty text" if isinstance(result, str) else f"{type(result).__name__} instead of a text"
            why = f"the emergency_stop of {name} returned {what}, which is no evidence of a stop"
            return StopOutcome(False, f"{why}: {PRESS}")
        return StopOutcome(True, text if self._driver in BUILT_IN_DRIVERS["stages"] else f"{name} reports: {text}")

    def _reserve(self) -> None:
        with contextlib.suppress(OSError):  # the system has no more file descriptors
            while len(self._reserved) < RESERVED_DESCRIPTORS:
                self._reserved.append(os.open(os.devnull, os.O_RDONLY))

    def _release(self) -> None:
        while self._reserved:
            os.close(self._reserved.pop())


def _shown(text: str) -> str:
    """Return a driver's text as one line of limited length."""
    return " ".join(text.split())[:MAX_TEXT]
