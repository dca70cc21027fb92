"""Backlog of a serial line on which the host sends as fast as the line transmits."""

import math
from collections import deque

#: Number of late replies in a row that indicate a backlog; an adapter may delay single replies by up to 16 ms.
LATE_REPLIES = 12
#: Smallest backlog for which the host pauses [s].
MIN_BACKLOG_S = 0.004


class Backlog:
    """Backlog of one serial line: the time that sent bytes wait for transmission.

    While the controller moves the robot, the host uses the full capacity of the line. If the operating system, an
    adapter or a slightly slower clock delays a message, all following messages are delayed as well, and this delay does
    not decrease. An idle line has no backlog, so replies on an idle line give the smallest delay.
    """

    def __init__(self) -> None:
        self._best = math.inf  # smallest delay of replies to requests on an idle line [s]
        self._late: deque[float] = deque(maxlen=LATE_REPLIES)
        self._paused = math.inf  # duration of the last pause [s]

    def observe(self, late: float, idle: bool) -> float:
        """Record a reply, and return the time by which the host must pause [s]; 0: no pause.

        Args:
            late: delay of the reply after its expected time [s].
            idle: whether the line was idle before the reply's request.
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
            self._best += behind  # the last pause had no effect, so this delay is normal for a busy line
            return 0.0
        self._paused = behind
        return behind
