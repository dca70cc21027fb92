"""Dahl's friction between neighbours that turn and slide on each other."""

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array


@compiled
def rub(most: float, stick: float, radius: float, turned: float, slid: float, old: Array, new: Array) -> None:
    """Dahl's friction after a path: `old` and `new` are force about and along the tangent [N], relative angle, seen.

    `turned` is the relative angle now [rad], `slid` the way since the tick before [m], of the inner tube on the outer.
    """
    new[2], new[3] = turned, 1.0
    if old[3] == 0.0:
        new[0] = new[1] = 0.0
        return
    about, along = radius * (turned - old[2]), slid
    way = np.sqrt(about * about + along * along)
    left, toward = np.exp(-way / stick), 0.0
    if way > 0.0:
        toward = most * (1.0 - left) / way
    new[0], new[1] = toward * about + left * old[0], toward * along + left * old[1]
    # What presses has become less: friction is never more than what it can hold.
    size = np.sqrt(new[0] * new[0] + new[1] * new[1])
    if size > most:
        new[0] *= most / size
        new[1] *= most / size
