"""Estimates the backlog of a line from the delays of its replies. Without I/O.

While the controller moves the robot, the host uses the full capacity of the line. Whatever delays a message (the
operating system, an adapter, a slightly slower clock) also delays all following messages, and this delay does not
decrease. An idle line has no backlog, so its replies give the smallest delay.
"""

import math
from collections import deque

#: Number of late replies in a row that indicate a backlog: an adapter may delay single ones by up to 16 ms.
LATE_REPLIES = 12
#: Smallest backlog that causes a pause [s].
MIN_BACKLOG_S = 0.004


class Backlog:
    """Backlog of one line."""

    def __init__(self) -> None:
        self._best = math.inf  # smallest delay of replies to requests on an idle line [s]
        self._late: deque[float] = deque(maxlen=LATE_REPLIES)
        self._paused = math.inf  # duration of the last pause [s]

    def observe(self, late: float, idle: bool) -> float:
        """Return the backlog [s], or 0 if it is too small for a pause.

        Args:
            late: delay of the reply after its expected time [s].
            idle: whether the line was idle before its request.
        """
        if idle:
            self._best = min(self._best, late)
            self._late.clear()
            return 0.0
        self._late.append(late)
        if len(self._late) < LATE_REPLIES or self._best == math.inf:
            return 0.0
        behind = min(self._late) - self._best
        self._late.clear()
        if behind < MIN_BACKLOG_S:
            self._paused = math.inf
            return 0.0
        if behind > 0.5 * self._paused:
            self._best += behind  # the pause had no effect: this is the normal delay of a busy line
            return 0.0
        self._paused = behind
        return behind
