"""Delay from the sending of a setpoint by a client to the serial line: three parts for each setpoint and axis.

sent ---- hearing ----> received ---- tick ----> tick ---- line ----> first byte of the axis's next velocity
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.devices.zaber.protocol import MESSAGE_TIME_S


class UsedSetpoint(NamedTuple):
    """Setpoints that the ticks of the control loop have used, oldest first; all times are of the same clock [s]."""

    ticks: Array  #: due time of each tick (m,) [s]
    setpoint: NDArray[np.int64]  #: index of the newest setpoint at each tick (m,); -1: none
    received: Array  #: time when the server received this setpoint (m,) [s]
    desired: NDArray[np.int64]  #: desired velocities of the axes (m, n) [units of the stages]
    sent: NDArray[np.int64]  #: velocities sent before each tick (m, n) [units of the stages]


class Delays(NamedTuple):
    """Parts of the delay, with one element for each pair of a used setpoint and an axis [s]."""

    hearing: Array  #: time from the sending of the setpoint to its reception by the server
    tick: Array  #: time from the reception to the tick that uses the setpoint
    line: Array  #: time from the tick to the start of the axis's next velocity command on the line (6 bytes, 6.25 ms)

    @property
    def whole(self) -> Array:
        """Whole delay: the sum of the three parts [s]."""
        return self.hearing + self.tick + self.line


def on_the_line(arrivals: Array) -> Array:
    """Return the times at which the serial line starts to transmit messages (m,) that reach it at `arrivals` [s]."""
    starts = np.empty_like(arrivals)
    free = -np.inf
    for number, time in enumerate(arrivals):
        starts[number] = max(free, time)
        free = starts[number] + MESSAGE_TIME_S
    return starts


def delays(sent_at: Array, used: UsedSetpoint, transmitted: Sequence[Array]) -> Delays:
    """Return the delays of the setpoints that a tick has used.

    A setpoint that was replaced before the next tick is not counted. A setpoint is also not counted for an axis whose
    velocity it leaves unchanged, because no command is sent to this axis.

    Args:
        sent_at: times at which the client sent the setpoints (s,) [s].
        used: setpoints that the control loop has used.
        transmitted: for each axis, times at which the line started to transmit velocity commands [s].
    """
    numbers, first = np.unique(used.setpoint, return_index=True)
    first = first[numbers >= 0]
    found: list[tuple[float, float, float]] = []
    for axis, times in enumerate(transmitted):
        # A row has the velocities that were sent before its tick. So a changed value was sent in the previous tick.
        out = np.flatnonzero(np.diff(used.sent[:, axis]) != 0)
        right = np.flatnonzero(used.desired[:, axis] == used.sent[:, axis])
        for tick in first:
            due, received = float(used.ticks[tick]), float(used.received[tick])
            sent, needless = _next(out, tick), _next(right, tick)
            if sent is None or (needless is not None and needless <= sent):
                continue
            on_line = _next(times, float(used.ticks[int(sent)]))
            if on_line is not None:
                found.append((received - float(sent_at[used.setpoint[tick]]), due - received, float(on_line) - due))
    table = np.array(found).reshape(-1, 3)
    return Delays(table[:, 0], table[:, 1], table[:, 2])


def figures(found: Delays) -> dict[str, Any]:
    """Return median, p99 and maximum of the whole delay and of its parts [ms]."""
    return {
        f"{name}_ms": dict(zip(("median", "p99", "max"), _three(part), strict=True))
        for name, part in (("whole", found.whole), *found._asdict().items())
    }


def _next(among: NDArray[Any], since: float) -> Any:
    """Return the first value of an ascending array that is at least `since`; None if all values are smaller."""
    index = int(np.searchsorted(among, since))
    return among[index] if index < len(among) else None


def _three(part: Array) -> list[float] | list[None]:
    if not part.size:
        return 3 * [None]
    return np.round(1e3 * np.percentile(part, [50, 99, 100]), 2).tolist()
