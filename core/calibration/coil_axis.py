"""Where the coil's axis points in the frame of the innermost tube's tip, from poses where the robot rested.

The frames are fitted to places alone and known before: of every pose the axis that was seen, carried into the frame
that the model has at the tip there, is the same axis again, so that their mean is the answer. A model that bends
too much does so in the tip's frame nearly alike at all poses, where nothing can tell it from a coil that sits
askew; how far the single poses are from their mean shows how good the model is.
"""

import math
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: A coil further askew sits otherwise than it should [rad].
MOST = math.radians(45.0)
LOOK = "the coil sits the wrong way round, or the joints are not where they are said to be"
#: Single poses further apart than this [rad] say more about the model than about the coil.
APART = math.radians(2.0)
DOUBTFUL = "the model does not bend as the robot does"


class CoilAxis(NamedTuple):
    """The coil's axis as it was found."""

    direction: Array  #: (3,) unit vector in the frame of the innermost tube's tip
    spread: float  #: of single poses about it, root mean square about each of two axes across [rad]
    refused: str = ""  #: why it is not to be used; empty when it is

    @property
    def askew(self) -> float:
        """Angle between it and the tip's own axis [rad]."""
        return math.atan2(math.hypot(self.direction[0], self.direction[1]), self.direction[2])


def coil_axis(turns: Array, seen: Array) -> CoilAxis:
    """The axis from the tip's frames (m, 3, 3) and the coil's axes (m, 3) at as many poses, robot's frame."""
    there = np.einsum("mji,mj->mi", turns, seen)
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    mean = there.mean(axis=0)
    direction = mean / float(np.linalg.norm(mean))
    across = there - (there @ direction)[:, None] * direction
    spread = math.sqrt(float(np.sum(across**2)) / (2.0 * max(len(there) - 1, 1)))
    found = CoilAxis(direction, spread)
    if found.askew > MOST:
        return found._replace(refused=f"more than {math.degrees(MOST):.0f} deg: {LOOK}")
    if spread > APART:
        return found._replace(refused=f"single poses say so within {math.degrees(spread):.1f} deg only: {DOUBTFUL}")
    return found
