"""Audit log of STOP, which any client may send without limit.

The first STOPs of a sender in a minute are logged in full. Further STOPs of the same sender are logged as a count with
the times of the first and the last one. Senders are distinguished by role and network address, because a client may
change its name with every request.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

from station.service.audit import Audit

#: Interval of the summaries [s]; number of full log lines of one sender in an interval; number of senders that are
#: counted separately.
PERIOD_S, MAX_LINES, MAX_SENDERS = 60.0, 3, 20


@dataclass
class _Minute:
    """Commands of one sender during the minute after its first logged line."""

    until: float
    #: names and outcomes of the commands that already have a log line
    written: set[tuple[str, str]] = field(default_factory=set[tuple[str, str]])
    repeats: int = 0
    first: str = ""  #: time of day of the first repeat
    last: str = ""  #: time of day of the last repeat


class Repeats:
    """Log of repeated commands: the first commands are written in full, further ones are counted. Not thread-safe."""

    def __init__(self, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._audit, self._clock = audit, clock
        self._senders: dict[tuple[str, str, str], _Minute] = {}  # by role, address and command

    def add(self, who: str, role: str, what: str, where: str, outcome: str) -> None:
        """Log or count one accepted command."""
        self.sum_up()
        sender = role, where, what
        if sender not in self._senders and len(self._senders) >= MAX_SENDERS:
            sender = role, "several", what
        minute = self._senders.setdefault(sender, _Minute(self._clock() + PERIOD_S))
        if (who, outcome) not in minute.written and len(minute.written) < MAX_LINES:
            minute.written.add((who, outcome))
            self._audit.write(who, what, where, outcome)
            return
        minute.repeats += 1
        minute.last = f"{datetime.now().astimezone():%H:%M:%S}"
        minute.first = minute.first or minute.last

    def sum_up(self, *, now: bool = False) -> None:
        """Log the number of repeats of each sender whose minute is over; with `now`, of all senders."""
        for sender, minute in list(self._senders.items()):
            if not now and self._clock() < minute.until:
                continue
            del self._senders[sender]
            if minute.repeats:
                role, where, what = sender
                names = {name for name, _ in minute.written}
                who = names.pop() if len(names) == 1 else f"several ({role})"
                outcome = f"repeated {minute.repeats} times, first {minute.first}, last {minute.last}"
                self._audit.write(who, what, where, outcome)
