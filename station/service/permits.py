"""Permits of commands that move the robot: issued when a request arrives, voided by any later STOP or reset.

The generation is a counter of STOPs and resets in shared memory. The control process, too, compares the counter with
the generation of each command, so that a STOP voids commands that are still in the pipe.

A permit may have further conditions: its sender is still the operator, the robot is not reserved, the run is still the
first one of the queue. `commit` checks all of them immediately before the command is sent, because the check of the
motion may have taken long.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from station.control.clock import StationClock
from station.control.commands import Reset
from station.control.ring import GENERATION, Ring
from station.control.states import RefusedError

#: Lifetime of the permit of a command that moves the robot, from the arrival of its request [s]. The check of a motion
#: takes one second, or half a minute on a very busy computer. A client that disconnects voids its command earlier.
DEADLINE_S = 120.0
#: Number of the latest STOPs and resets whose causes are kept for error messages.
MAX_CAUSES = 64


class VoidError(RefusedError):
    """A command is older than a STOP or a reset, has waited too long, or is not permitted any longer."""


@dataclass(frozen=True)
class Permit:
    """Permit of one command that moves the robot, from the arrival of its request until it is sent."""

    permits: "Permits"
    generation: int  #: number of STOPs and resets before the request arrived
    until: float  #: time at which the permit expires, by the station's clock [s]
    gone: Callable[[], bool] | None = None  #: returns whether the client has disconnected; thread-safe
    #: each returns why the command is not permitted now; empty: it is permitted; thread-safe
    conditions: tuple[Callable[[], str], ...] = ()
    #: last condition, called once when the command is sent; after an empty text the command counts as sent; thread-safe
    claim: Callable[[], str] | None = None

    def check(self, what: str) -> None:
        """Check that the permit still allows the command `what`.

        Raises:
            VoidError: the permit is void; the text has the reason (such as a later STOP) and an instruction.
        """
        if problem := self.permits.problem(self, what):
            raise VoidError(f"'{what}' is void: {''.join(problem)}")

    def problem(self, what: str) -> str:
        """Return why the permit does not allow the command `what`; empty if it allows the command."""
        return (self.permits.problem(self, what) or ("", ""))[0]

    def commit(self, what: str) -> None:
        """Check the permit for the last time, immediately before the caller sends the command `what`.

        Raises:
            VoidError: as in `check`.
        """
        self.check(what)
        if self.claim is not None and (reason := self.claim()):
            raise VoidError(f"'{what}' is void: {reason}")

    def on(self, *conditions: Callable[[], str]) -> "Permit":
        """Return a copy of this permit with further conditions."""
        return replace(self, conditions=(*self.conditions, *conditions))

    def without_deadline(self) -> "Permit":
        """Return a copy of this permit without deadline and client, but with its conditions."""
        return replace(self, until=math.inf, gone=None)

    def lasting(self) -> "Permit":
        """Return a copy of this permit without conditions, for a procedure that only a STOP or a reset ends."""
        return replace(self.without_deadline(), conditions=(), claim=None)


class Permits:
    """Permits of one station; its methods are thread-safe."""

    def __init__(self, ring: Ring, clock: StationClock) -> None:
        self._ring, self._clock = ring, clock
        self._lock = threading.Lock()
        self._causes = deque[str](maxlen=MAX_CAUSES)
        self._stop = (0, "")  # generation and cause of the latest STOP

    def issue(self, gone: Callable[[], bool] | None = None) -> Permit:
        """Return a permit for a request that arrives now; `gone` returns whether its client has disconnected."""
        return Permit(self, int(self._ring.counters[GENERATION]), self._clock.now() + DEADLINE_S, gone)

    def void(self, cause: str, *, stop: bool) -> None:
        """Void every earlier permit; refusals contain `cause`. Only a STOP voids the permit of a reset."""
        with self._lock:
            self._causes.append(cause)
            self._ring.counters[GENERATION] += 1
            if stop:
                self._stop = (int(self._ring.counters[GENERATION]), cause)

    def problem(self, permit: Permit, what: str) -> tuple[str, str] | None:
        """Return why a permit does not allow the command `what`, and an instruction; None: the permit allows it."""
        with self._lock:
            newest, cause = int(self._ring.counters[GENERATION]), ""
            if what == Reset.name:
                newest, cause = self._stop
            elif later := newest - permit.generation:
                # The cause of the first STOP or reset after the request.
                cause = self._causes[-min(later, len(self._causes))]
        if permit.generation < newest:
            return (
                f"the station was {cause}",
                " after this request arrived; check the robot, then send the request again",
            )
        if permit.gone is not None and permit.gone():
            return "its client disconnected before it was executed", "; send it again and wait"
        if self._clock.now() > permit.until:
            return (
                f"it was not executed within {DEADLINE_S:g} s of its request",
                " (a slow check of the motion, or a recorder that restarts); send it again",
            )
        return next(((reason, "") for condition in permit.conditions if (reason := condition())), None)
