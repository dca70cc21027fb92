"""What calibration has found out about coil and sensors, taken out of every sample before it is used."""

from dataclasses import dataclass, field

import numpy as np

from core.control.sensors import Sensors
from core.robot.robot import Array


@dataclass(frozen=True)
class Corrections:
    """A coil that is not at the tip, sensors that are mounted askew or carry a weight."""

    sensors: Sensors
    coil: Array = field(default_factory=lambda: np.zeros(3))  #: (3,) in the frame of the innermost tube's tip [m]

    def tip(self, coil: Array, rotation: Array) -> Array:
        """The tip (3,) when the coil is measured at `coil` (3,) [m] and the tip's frame is `rotation` (3, 3).

        The frame is the model's: of an offset of a millimetre its error takes micrometres.
        """
        return coil - rotation @ self.coil

    def wrenches(self, tared: Array, alpha: Array) -> Array:
        """What the tubes exert (q, 6) of tared readings (q, 6) at rotations alpha (q,) [N, N m]."""
        return self.sensors.exerted(tared, alpha)

    def offset(self, readings: Array, alpha: Array) -> Array:
        """The tare (q, 6) of readings (q, 6) without load: what hangs on the sensors stays in."""
        return readings - self.sensors.hanging(alpha)
