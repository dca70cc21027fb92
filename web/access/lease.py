"""The operator's lease: one client at a time may send commands; the lease expires if this client is silent.

Every request of the operator renews the lease. A command of a second client is refused with the operator's name;
the second client may take the lease over explicitly. STOP needs no lease.

A tenure is the time from the moment in which a client becomes operator until the lease is released, taken over or
expires. The end of a tenure voids the operator's requests that the station has not started yet.
"""

import itertools
import time
from collections.abc import Callable
from typing import NamedTuple

from station.client import NOT_OPERATOR
from station.control.states import RefusedError

#: The lease expires after this time without a request of the operator [s].
LEASE_S = 10.0


class Holder(NamedTuple):
    """The client that holds the lease: the operator."""

    client: str  #: secret identity of the operator's client
    name: str  #: display name of the operator, which all clients may read
    until: float  #: time at which the lease expires [s]
    tenure: int  #: number of the tenure, from 1


class LeaseHeldError(RefusedError):
    """A command was refused because another client is operator."""


class Lease:
    """The one operator's lease of a station; `clock` returns the time [s].

    Only one thread may change the lease; any thread may read it.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, length: float = LEASE_S) -> None:
        self._clock, self._length = clock, length
        self._holder: Holder | None = None
        self._tenures = itertools.count(1)

    def holder(self) -> Holder | None:
        """Return the operator; None: there is no operator."""
        holder = self._holder
        return None if holder is None or self._clock() >= holder.until else holder

    def ended(self, holder: Holder) -> str:
        """Return why the tenure of an operator has ended; empty while it lasts. Thread-safe."""
        now = self.holder()
        if now is not None and now.tenure == holder.tenure:
            return ""
        if now is not None and now.client != holder.client:
            return f"'{now.name}' is operator instead of '{holder.name}'"
        return f"the operator '{holder.name}' has left"

    def left(self) -> float:
        """Return the time until the lease expires [s]; 0 without an operator."""
        holder = self._holder
        return 0.0 if holder is None else max(0.0, holder.until - self._clock())

    def holds(self, client: str) -> bool:
        """Return whether this client is operator."""
        holder = self.holder()
        return holder is not None and holder.client == client

    def take(self, client: str, name: str, *, over: bool = False) -> Holder:
        """Take or renew the lease for `client`; with `over`, take it even if another client is operator.

        Raises:
            LeaseHeldError: another client is operator.
        """
        holder = self.holder()
        if holder is not None and holder.client != client and not over:
            raise LeaseHeldError(
                f"'{holder.name}'{NOT_OPERATOR}; ask them, or take over (POST /api/operator with take_over)"
            )
        tenure = holder.tenure if holder is not None and holder.client == client else next(self._tenures)
        self._holder = taken = Holder(client, name, self._clock() + self._length, tenure)
        return taken

    def keep(self, client: str, name: str) -> Holder:
        """Renew the lease without changing the operator's name, or take a free lease under the name `name`.

        Raises:
            LeaseHeldError: another client is operator.
        """
        holder = self.holder()
        return self.take(client, holder.name if holder is not None and holder.client == client else name)

    def renew(self, client: str) -> None:
        """Renew the lease if `client` is operator."""
        holder = self.holder()
        if holder is not None and holder.client == client:
            self._holder = holder._replace(until=self._clock() + self._length)

    def release(self, client: str) -> None:
        """Release the lease if `client` is operator."""
        if self.holds(client):
            self._holder = None
