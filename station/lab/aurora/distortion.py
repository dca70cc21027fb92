"""The field of an electromagnetic tracker near metal: a smooth error of the position, the same at the same place.

A sum of plane waves longer than half of the measured cube, drawn from a seed and scaled to the wanted RMS.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from core.robot.robot import Array

WAVES = 8
#: Lengths of the waves [m].
SHORTEST, LONGEST = 0.30, 1.0
#: Points along each edge of the cube at which the RMS is made what it should be.
GRID = 12


@dataclass(frozen=True)
class Distortion:
    """What the tracker adds to a position."""

    waves: Array  #: wave vectors (w, 3) [rad/m]
    phases: Array  #: (w,) [rad]
    amplitudes: Array  #: (w, 3) [m]

    @classmethod
    def drawn(cls, rms: float, box: Array, rng: np.random.Generator) -> Self:
        """A field whose length has this RMS [m] over a box, lower and upper bound of each axis (3, 2) [m]."""
        directions = rng.standard_normal((WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        waves = directions * (2.0 * np.pi / rng.uniform(SHORTEST, LONGEST, (WAVES, 1)))
        field = cls(waves, rng.uniform(0.0, 2.0 * np.pi, WAVES), rng.standard_normal((WAVES, 3)))
        edges = [np.linspace(low, high, GRID) for low, high in box]
        errors = field.at(np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3))
        found = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
        return cls(field.waves, field.phases, field.amplitudes * (rms / found))

    def at(self, positions: Array) -> Array:
        """Errors (..., 3) [m] at `positions` (..., 3) [m]."""
        return np.sin(positions @ self.waves.T + self.phases) @ self.amplitudes
