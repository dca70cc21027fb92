"""How far a line is behind what the host believes, told from how late its replies come. Sans-I/O.

While the controller moves the robot, the host fills the line to the last bit: whatever holds a message up (the
operating system, an adapter, a clock that runs a little slower) holds up all that follow, and is never made up
for. A line that was idle has no backlog, so that replies from then say how late a reply is at its best.
"""

import math
from collections import deque

#: So many replies in a row have to be late: an adapter may hold single ones back for up to 16 ms.
REPLIES = 12
#: A backlog that is worth a pause [s].
WORTH = 0.004


class Backlog:
    """The replies of one line."""

    def __init__(self) -> None:
        self._best = math.inf  # of all replies to requests that found the line idle [s]
        self._late: deque[float] = deque(maxlen=REPLIES)
        self._paused = math.inf  # for so long, the last time [s]

    def heard(self, late: float, idle: bool) -> float:
        """How far the line is behind [s]; 0 as long as it is not worth a pause.

        Args:
            late: the reply came so long after it was expected [s].
            idle: its request found the line idle.
        """
        if idle:
            self._best = min(self._best, late)
            self._late.clear()
            return 0.0
        self._late.append(late)
        if len(self._late) < REPLIES or self._best == math.inf:
            return 0.0
        behind = min(self._late) - self._best
        self._late.clear()
        if behind < WORTH:
            self._paused = math.inf
            return 0.0
        if behind > 0.5 * self._paused:
            self._best += behind  # the pause has not helped: a busy line's replies are as late as that
            return 0.0
        self._paused = behind
        return behind
