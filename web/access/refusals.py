"""Refusals in the audit log: the first of a minute as they were, the others as a number.

A page of another site can send thousands a second, and let each look different.
"""

import time
from collections import Counter
from collections.abc import Callable

from station.service.audit import Audit

#: Refusals are summed up so often [s], and so many are written out meanwhile.
PERIOD, MOST = 60.0, 100


class Refusals:
    """Counts them. Not for several threads."""

    def __init__(self, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._audit, self._clock = audit, clock
        self._until = 0.0
        self._written = 0
        self._more: Counter[str] = Counter()  # by address

    def add(self, who: str, what: str, where: str, outcome: str) -> None:
        """One that was refused."""
        self.sum_up()
        if not self._written:
            self._until = self._clock() + PERIOD
        if self._written < MOST:
            self._written += 1
            self._audit.refused(who, what, where, outcome)
        else:
            self._more[where] += 1

    def sum_up(self, *, now: bool = False) -> None:
        """Write down how many there were besides, once the time is over."""
        if not self._written or (self._clock() < self._until and not now):
            return
        if self._more:
            where = ", ".join(address for address, _ in self._more.most_common(5)) + ", ..." * (len(self._more) > 5)
            self._audit.refused("several", f"{self._more.total()} more requests", where, "refused within a minute")
        self._written = 0
        self._more.clear()
