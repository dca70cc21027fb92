"""What stands between a base sensor's reading and the wrench that its tube exerts: gain, mounting, hanging weight.

The offset is not here: it is tared before every run.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array


@dataclass(frozen=True)
class Sensors:
    """How far off the base sensors are, how they are mounted, and what they carry beside the tubes."""

    mounting: Array  #: (q, 3, 3) sensor's axes -> the tube's
    weight: Array  #: (q,) [N]
    first_moment: Array  #: (q, 3) weight times its place in the tube's axes [N m]
    gravity: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))  #: (3,) direction, plate's frame
    #: (q, 6, 6) what has to be taken from a reading for each part of it: errors of gain and cross-talk; None: nothing.
    skew: Array | None = None

    @cached_property
    def matrix(self) -> Array:
        """(q, 6, 6): a reading without offset -> the wrench in the tube's axes, hanging weight included."""
        turn = np.zeros((len(self.weight), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = self.mounting
        if self.skew is None:
            return turn
        return np.asarray(turn @ (np.eye(6) - self.skew), dtype=np.float64)

    @classmethod
    def ideal(cls, tubes: int) -> "Sensors":
        """Mounted straight, carrying nothing."""
        return cls(np.tile(np.eye(3), (tubes, 1, 1)), np.zeros(tubes), np.zeros((tubes, 3)))

    def exerted(self, wrenches: Array, alpha: Array) -> Array:
        """What the tubes exert (q, 6), in their axes, of readings (q, 6) without offset at rotations alpha (q,)."""
        return exerted(wrenches, alpha, self.matrix, self.weight, self.first_moment, self.gravity)

    def hanging(self, alpha: Array) -> Array:
        """What the sensors read (q, 6) of the weight that hangs on them alone, at rotations alpha (q,)."""
        nothing = np.zeros((alpha.size, 6))
        weight = -exerted(nothing, alpha, self.matrix, self.weight, self.first_moment, self.gravity)
        return np.asarray(np.linalg.solve(self.matrix, weight[:, :, None])[:, :, 0], dtype=np.float64)


@compiled
def exerted(wrenches: Array, alpha: Array, matrix: Array, weight: Array, first_moment: Array, gravity: Array) -> Array:
    """`Sensors.exerted` for compiled code: readings (q, 6), rotations (q,), then the sensors' numbers."""
    result = np.zeros_like(wrenches)
    for i in range(alpha.shape[0]):
        cos, sin = np.cos(alpha[i]), np.sin(alpha[i])
        gx, gy, gz = cos * gravity[0] + sin * gravity[1], cos * gravity[1] - sin * gravity[0], gravity[2]
        x, y, z = first_moment[i, 0], first_moment[i, 1], first_moment[i, 2]
        for k in range(6):
            for m in range(6):
                result[i, k] += matrix[i, k, m] * wrenches[i, m]
        result[i, 0] -= weight[i] * gx
        result[i, 1] -= weight[i] * gy
        result[i, 2] -= weight[i] * gz
        result[i, 3] -= y * gz - z * gy
        result[i, 4] -= z * gx - x * gz
        result[i, 5] -= x * gy - y * gx
    return result
