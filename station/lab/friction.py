"""Dahl friction between neighbouring tubes that turn and slide on each other."""

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array


@compiled
def dahl_friction(
    limit: float, stick: float, radius: float, turned: float, slid: float, old: Array, new: Array
) -> None:
    """Write to `new` the Dahl friction after a motion of the inner tube relative to the outer one, from `old`.

    `old` and `new` have four numbers: friction force about and along the tangent [N], relative angle [rad], and a flag
    that is 1 after the first call. `turned` is the current relative angle [rad], `slid` the sliding distance since the
    previous tick [m], `limit` the largest friction force [N], `stick` the path over which friction reverses [m], and
    `radius` the contact radius [m].
    """
    new[2], new[3] = turned, 1.0
    if old[3] == 0.0:
        new[0] = new[1] = 0.0
        return
    about, along = radius * (turned - old[2]), slid
    distance = np.sqrt(about * about + along * along)
    decay, toward = np.exp(-distance / stick), 0.0
    if distance > 0.0:
        toward = limit * (1.0 - decay) / distance
    new[0], new[1] = toward * about + decay * old[0], toward * along + decay * old[1]
    # The limit falls with the normal force. The friction from before may then exceed the limit and is reduced to it.
    size = np.sqrt(new[0] * new[0] + new[1] * new[1])
    if size > limit:
        new[0] *= limit / size
        new[1] *= limit / size
