"""Direction of the tracker coil's axis in the frame of the innermost tube's tip, from poses of the robot at rest.

The model's tip frames come from an earlier fit to positions alone. At every pose the measured axis is transformed into
the model's tip frame. There the axis should be the same at all poses, so the result is the mean over the poses. A model
whose tubes bend too much causes nearly the same error in the tip frame at all poses. This error cannot be distinguished
from a misaligned coil. The deviation of the axis at single poses from the mean shows how good the model is.
"""

import math
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Largest plausible angle between the coil's axis and the tip's axis [rad]; beyond this angle the mounting is wrong.
MAX_MISALIGNMENT_RAD = math.radians(45.0)
COIL_HINT = "the coil is mounted backwards, or the reported joint positions are wrong"
#: Largest accepted spread of the axis over single poses [rad]; beyond this spread the model's error dominates.
MAX_SPREAD_RAD = math.radians(2.0)
MODEL_HINT = "the model does not bend like the robot"


class CoilAxis(NamedTuple):
    """The estimated axis of the coil."""

    direction: Array  #: (3,) unit vector in the frame of the innermost tube's tip
    spread: float  #: root mean square deviation of single poses, per perpendicular axis [rad]
    refused: str = ""  #: reason why the result must not be used; empty if the result may be used

    @property
    def misalignment(self) -> float:
        """Angle between the coil's axis and the tip's axis [rad]."""
        return math.atan2(math.hypot(self.direction[0], self.direction[1]), self.direction[2])


def coil_axis(turns: Array, measured: Array) -> CoilAxis:
    """Estimate the coil axis from tip frames (m, 3, 3) and measured coil axes (m, 3) of m poses, robot's frame."""
    there = np.einsum("mji,mj->mi", turns, measured)
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    mean = there.mean(axis=0)
    direction = mean / float(np.linalg.norm(mean))
    across = there - (there @ direction)[:, None] * direction
    spread = math.sqrt(float(np.sum(across**2)) / (2.0 * max(len(there) - 1, 1)))
    found = CoilAxis(direction, spread)
    if found.misalignment > MAX_MISALIGNMENT_RAD:
        return found._replace(refused=f"more than {math.degrees(MAX_MISALIGNMENT_RAD):.0f} deg: {COIL_HINT}")
    if spread > MAX_SPREAD_RAD:
        return found._replace(refused=f"single poses deviate by {math.degrees(spread):.1f} deg: {MODEL_HINT}")
    return found
