"""One operator at a time: a lease with a name that lapses when its holder falls silent.

Everything that the holder sends renews it. Whoever comes second is told who holds it, and may take
it over on purpose. STOP needs no lease.
"""

from typing import NamedTuple

from station.states import RefusedError

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
    """The station's one lease; `now` [s] comes from the caller's clock. Not for several threads."""

    def __init__(self, length: float = LENGTH) -> None:
        self._length = length
        self._holder: Holder | None = None

    def holder(self, now: float) -> Holder | None:
        """Who holds it at `now`."""
        if self._holder is not None and now >= self._holder.until:
            self._holder = None
        return self._holder

    def holds(self, client: str, now: float) -> bool:
        """Whether it is this client."""
        holder = self.holder(now)
        return holder is not None and holder.client == client

    def take(self, client: str, name: str, now: float, *, over: bool = False) -> Holder:
        """Take or keep the lease; with `over` also from somebody else.

        Raises:
            HeldError: somebody else holds it.
        """
        holder = self.holder(now)
        if holder is not None and holder.client != client and not over:
            raise HeldError(
                f"'{holder.name}' is operator; ask them, or take over on purpose (POST /api/operator with take_over)"
            )
        self._holder = Holder(client, name, now + self._length)
        return self._holder

    def renew(self, client: str, now: float) -> None:
        """A word from `client`; nothing happens when it does not hold the lease."""
        holder = self.holder(now)
        if holder is not None and holder.client == client:
            self._holder = holder._replace(until=now + self._length)

    def release(self, client: str, now: float) -> None:
        """Give it back; nothing happens when `client` does not hold it."""
        if self.holds(client, now):
            self._holder = None
