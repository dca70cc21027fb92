"""Calibrated base sensors: conversion between a sensor's reading and the wrench of its tube.

The conversion includes the sensor's gain, its mounting, and the weight of parts that hang on the sensor. The sensor's
offset is excluded, because it is tared before every run.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array


@dataclass(frozen=True)
class Sensors:
    """Gain errors and mounting of the base sensors, and the weight of other parts than the tubes that hang on them."""

    mounting: Array  #: (q, 3, 3) rotation from each sensor's axes to its tube's axes
    weight: Array  #: (q,) weight that hangs on each sensor [N]
    first_moment: Array  #: (q, 3) hanging weight times the position of its centre in the tube's axes [N m]
    #: (3,) direction of gravity in the plate's frame, unit vector
    gravity: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    #: (q, 6, 6) errors of gain and cross-talk: this matrix times the reading is subtracted from the reading; None:
    #: zero.
    skew: Array | None = None

    @cached_property
    def matrix(self) -> Array:
        """Matrices (q, 6, 6) from a reading without offset to the wrench in the tube's axes, with hanging weight."""
        turn = np.zeros((len(self.weight), 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = self.mounting
        if self.skew is None:
            return turn
        return np.asarray(turn @ (np.eye(6) - self.skew), dtype=np.float64)

    @classmethod
    def ideal(cls, tubes: int) -> "Sensors":
        """Return sensors with exact gain and mounting, without hanging weight."""
        return cls(np.tile(np.eye(3), (tubes, 1, 1)), np.zeros(tubes), np.zeros((tubes, 3)))

    def exerted(self, wrenches: Array, alpha: Array) -> Array:
        """Return the wrenches (q, 6) in the tubes' axes from readings (q, 6) without offset at rotations alpha (q,)."""
        return exerted(wrenches, alpha, self.matrix, self.weight, self.first_moment, self.gravity)

    def hanging(self, alpha: Array) -> Array:
        """Return the readings (q, 6) that the hanging weight alone causes at rotations alpha (q,)."""
        nothing = np.zeros((alpha.size, 6))
        weight = -exerted(nothing, alpha, self.matrix, self.weight, self.first_moment, self.gravity)
        return np.asarray(np.linalg.solve(self.matrix, weight[:, :, None])[:, :, 0], dtype=np.float64)


@compiled
def exerted(wrenches: Array, alpha: Array, matrix: Array, weight: Array, first_moment: Array, gravity: Array) -> Array:
    """Compute `Sensors.exerted` in compiled code: readings (q, 6), rotations (q,), then the sensors' parameters."""
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
