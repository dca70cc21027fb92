"""Distortion of an electromagnetic tracker by nearby metal: a smooth position error that is constant in time.

The error is a sum of plane waves longer than half of the measured cube. They are drawn from a seed and scaled to the
configured RMS.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from core.robot.robot import Array

WAVE_COUNT = 8
#: Shortest and longest wave of the distortion [m].
MIN_WAVELENGTH_M, MAX_WAVELENGTH_M = 0.30, 1.0
#: Number of points along each edge of the measured cube at which the RMS of the distortion is computed.
GRID_POINTS = 12


@dataclass(frozen=True)
class Distortion:
    """Position error of the tracker as a function of the position."""

    waves: Array  #: wave vectors (w, 3) [rad/m]
    phases: Array  #: (w,) [rad]
    amplitudes: Array  #: (w, 3) [m]

    @classmethod
    def drawn(cls, rms: float, box: Array, rng: np.random.Generator) -> Self:
        """Return a field whose length has this RMS [m] over a box: lower and upper bound of each axis (3, 2) [m]."""
        directions = rng.standard_normal((WAVE_COUNT, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        waves = directions * (2.0 * np.pi / rng.uniform(MIN_WAVELENGTH_M, MAX_WAVELENGTH_M, (WAVE_COUNT, 1)))
        field = cls(waves, rng.uniform(0.0, 2.0 * np.pi, WAVE_COUNT), rng.standard_normal((WAVE_COUNT, 3)))
        edges = [np.linspace(low, high, GRID_POINTS) for low, high in box]
        errors = field.at(np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3))
        found = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
        return cls(field.waves, field.phases, field.amplitudes * (rms / found))

    def at(self, positions: Array) -> Array:
        """Return the errors (..., 3) [m] at `positions` (..., 3) [m]."""
        return np.sin(positions @ self.waves.T + self.phases) @ self.amplitudes
