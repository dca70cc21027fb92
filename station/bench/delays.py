"""From somebody's setpoint to the line of the stages: three delays for each setpoint and axis, without a clock.

said ---- hearing ----> told ---- tick ----> tick ---- line ----> first byte of the axis's next velocity
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.devices.zaber.protocol import MESSAGE_TIME


class Used(NamedTuple):
    """What the ticks of the loop have made of it, oldest first; times by one clock [s]."""

    ticks: Array  #: (m,) when each was due
    setpoint: NDArray[np.int64]  #: (m,) number of the newest one that it knew, -1: none
    told: Array  #: (m,) when that had come to the server
    wanted: NDArray[np.int64]  #: (m, n) velocities that it asked for [units of the stages]
    sent: NDArray[np.int64]  #: (m, n) those that had gone out before it


class Delays(NamedTuple):
    """One row for each setpoint that a tick has used, and each axis [s]."""

    hearing: Array  #: from the sender until the server has taken the message in
    tick: Array  #: from there to the tick that uses it
    line: Array  #: from there until the line takes up the axis's next velocity, six bytes in 6.25 ms

    @property
    def whole(self) -> Array:
        """From the sender to the line."""
        return self.hearing + self.tick + self.line


def on_the_line(come: Array) -> Array:
    """When the line takes up each message (m,) that has come to it at these times [s], one after the other."""
    begun = np.empty_like(come)
    free = -np.inf
    for number, time in enumerate(come):
        begun[number] = max(free, time)
        free = begun[number] + MESSAGE_TIME
    return begun


def delays(said: Array, used: Used, heard: Sequence[Array]) -> Delays:
    """The delays of the setpoints that a tick has used.

    One that was followed by the next before a tick looked is not counted: the last one wins. Neither is, for an axis,
    one that wants no other velocity of it than it has: nothing is sent then.

    Args:
        said: (s,) when each setpoint was sent [s].
        used: what the loop made of them.
        heard: of each axis, when the line took up its velocities [s].
    """
    numbers, first = np.unique(used.setpoint, return_index=True)
    first = first[numbers >= 0]
    found: list[tuple[float, float, float]] = []
    for axis, times in enumerate(heard):
        # A row tells what went out before its tick: a new velocity went out in the tick before it.
        out = np.flatnonzero(np.diff(used.sent[:, axis]) != 0)
        right = np.flatnonzero(used.wanted[:, axis] == used.sent[:, axis])
        for tick in first:
            due, told = float(used.ticks[tick]), float(used.told[tick])
            sent, needless = _next(out, tick), _next(right, tick)
            if sent is None or (needless is not None and needless <= sent):
                continue
            on_line = _next(times, float(used.ticks[int(sent)]))
            if on_line is not None:
                found.append((told - float(said[used.setpoint[tick]]), due - told, float(on_line) - due))
    table = np.array(found).reshape(-1, 3)
    return Delays(table[:, 0], table[:, 1], table[:, 2])


def figures(found: Delays) -> dict[str, Any]:
    """Median, p99 and largest of the whole and of its parts [ms]."""
    return {
        f"{name}_ms": dict(zip(("median", "p99", "max"), _three(part), strict=True))
        for name, part in (("whole", found.whole), *found._asdict().items())
    }


def _next(among: NDArray[Any], since: float) -> Any:
    """The first of an ascending row that is not below `since`; None: all are."""
    place = int(np.searchsorted(among, since))
    return among[place] if place < len(among) else None


def _three(part: Array) -> list[float] | list[None]:
    if not part.size:
        return 3 * [None]
    return np.round(1e3 * np.percentile(part, [50, 99, 100]), 2).tolist()
