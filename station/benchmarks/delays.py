"""Delays from a client's setpoint to the line of the stages: three parts for each setpoint and axis.

sent ---- hearing ----> received ---- tick ----> tick ---- line ----> first byte of the axis's next velocity
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.devices.zaber.protocol import MESSAGE_TIME_S


class UsedSetpoint(NamedTuple):
    """Setpoints that the ticks of the loop have used, oldest first; times of one clock [s]."""

    ticks: Array  #: (m,) due time of each tick
    setpoint: NDArray[np.int64]  #: (m,) index of the newest setpoint at this tick, -1: none
    received: Array  #: (m,) time when the server received it
    desired: NDArray[np.int64]  #: (m, n) desired velocities [units of the stages]
    sent: NDArray[np.int64]  #: (m, n) velocities sent before this tick


class Delays(NamedTuple):
    """One row for each setpoint that a tick has used, and each axis [s]."""

    hearing: Array  #: from sending to the reception by the server
    tick: Array  #: from the reception to the tick that uses it
    line: Array  #: from the tick until the line transmits the axis's next velocity, six bytes in 6.25 ms

    @property
    def whole(self) -> Array:
        """Delay from the sender to the line [s]."""
        return self.hearing + self.tick + self.line


def on_the_line(arrivals: Array) -> Array:
    """Return when the line starts to transmit each message (m,) that arrived at these times [s]."""
    starts = np.empty_like(arrivals)
    free = -np.inf
    for number, time in enumerate(arrivals):
        starts[number] = max(free, time)
        free = starts[number] + MESSAGE_TIME_S
    return starts


def delays(sent_at: Array, used: UsedSetpoint, transmitted: Sequence[Array]) -> Delays:
    """Return the delays of the setpoints that a tick has used.

    A setpoint that was replaced before the next tick is not counted. For an axis, a setpoint that does not
    change its velocity is not counted either: nothing is sent then.

    Args:
        sent_at: (s,) when each setpoint was sent [s].
        used: the setpoints used by the loop.
        transmitted: for each axis, when the line started to transmit its velocities [s].
    """
    numbers, first = np.unique(used.setpoint, return_index=True)
    first = first[numbers >= 0]
    found: list[tuple[float, float, float]] = []
    for axis, times in enumerate(transmitted):
        # A row contains the velocities sent before its tick: a new velocity was sent in the previous tick.
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
    """Return the first value of an ascending row that is not below `since`; None if all are below."""
    index = int(np.searchsorted(among, since))
    return among[index] if index < len(among) else None


def _three(part: Array) -> list[float] | list[None]:
    if not part.size:
        return 3 * [None]
    return np.round(1e3 * np.percentile(part, [50, 99, 100]), 2).tolist()
