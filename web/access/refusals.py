"""Refused requests in the audit log: the first ones of each minute in full, the others as a count.

The number of lines is limited because a page of another site can send thousands of different requests a second.
"""

import time
from collections import Counter
from collections.abc import Callable

from station.service.audit import Audit

#: Interval of the summaries [s], and number of refusals that are logged in full in one interval.
SUMMARY_INTERVAL_S, MAX_WRITTEN = 60.0, 100


class Refusals:
    """Log of refused requests: the first requests are written in full, further ones are counted. Not thread-safe."""

    def __init__(self, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._audit, self._clock = audit, clock
        self._until = 0.0
        self._written = 0
        self._more: Counter[str] = Counter()  # number of refusals that were only counted, by network address

    def add(self, who: str, what: str, where: str, outcome: str) -> None:
        """Log or count one refused request."""
        self.sum_up()
        if not self._written:
            self._until = self._clock() + SUMMARY_INTERVAL_S
        if self._written < MAX_WRITTEN:
            self._written += 1
            self._audit.refused(who, what, where, outcome)
        else:
            self._more[where] += 1

    def sum_up(self, *, now: bool = False) -> None:
        """Log how many refusals were only counted, if the interval is over or if `now` is true."""
        if not self._written or (self._clock() < self._until and not now):
            return
        if self._more:
            where = ", ".join(address for address, _ in self._more.most_common(5)) + ", ..." * (len(self._more) > 5)
            self._audit.refused("several", f"{self._more.total()} more requests", where, "refused within a minute")
        self._written = 0
        self._more.clear()
