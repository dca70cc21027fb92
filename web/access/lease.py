"""One operator at a time: a lease with a name that lapses when its holder falls silent.

Everything that the holder sends renews it. Whoever comes second is told who holds it, and may take
it over on purpose. STOP needs no lease.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

from station.control.states import RefusedError

#: The lease lapses after this time without a word from its holder [s].
LENGTH = 10.0


class Holder(NamedTuple):
    """Who commands."""

    client: str  #: identity, known to its owner only
    name: str  #: for everybody to see
    until: float  #: when it lapses [s]


class HeldError(RefusedError):
    """Somebody else commands."""


class Lease:
    """The station's one lease, by a clock that tells seconds. Not for several threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, length: float = LENGTH) -> None:
        self._clock, self._length = clock, length
        self._holder: Holder | None = None

    def holder(self) -> Holder | None:
        """Who holds it."""
        if self._holder is not None and self._clock() >= self._holder.until:
            self._holder = None
        return self._holder

    def left(self) -> float:
        """Until it lapses [s]; 0 when nobody holds it."""
        return 0.0 if self._holder is None else max(0.0, self._holder.until - self._clock())

    def holds(self, client: str) -> bool:
        """Whether it is this client."""
        holder = self.holder()
        return holder is not None and holder.client == client

    def take(self, client: str, name: str, *, over: bool = False) -> Holder:
        """Take or keep the lease; with `over` also from somebody else.

        Raises:
            HeldError: somebody else holds it.
        """
        holder = self.holder()
        if holder is not None and holder.client != client and not over:
            raise HeldError(
                f"'{holder.name}' is operator; ask them, or take over on purpose (POST /api/operator with take_over)"
            )
        self._holder = Holder(client, name, self._clock() + self._length)
        return self._holder

    def keep(self, client: str, name: str) -> Holder:
        """Keep the lease, under the name that it was taken with, or take it as `name` because nobody has it.

        Raises:
            HeldError: somebody else holds it.
        """
        holder = self.holder()
        return self.take(client, holder.name if holder is not None and holder.client == client else name)

    def renew(self, client: str) -> None:
        """A word from `client`; nothing happens when it does not hold the lease."""
        holder = self.holder()
        if holder is not None and holder.client == client:
            self._holder = holder._replace(until=self._clock() + self._length)

    def release(self, client: str) -> None:
        """Give it back; nothing happens when `client` does not hold it."""
        if self.holds(client):
            self._holder = None
