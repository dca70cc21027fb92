"""What calibration has found out about coil and sensors, taken out of every sample before it is used."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.control.sensors import Sensors
from core.robot.robot import Array


@dataclass(frozen=True)
class Corrections:
    """A coil that is not at the tip or not along it, sensors that are mounted askew or carry a weight."""

    sensors: Sensors
    coil: Array = field(default_factory=lambda: np.zeros(3))  #: (3,) in the frame of the innermost tube's tip [m]
    axis: Array | None = None  #: (3,) of the coil in that frame, unit vector; None: nobody has looked, it is the tip's

    def tip(self, coil: Array, rotation: Array) -> Array:
        """The tip (3,) when the coil is measured at `coil` (3,) [m] and the tip's frame is `rotation` (3, 3).

        The frame is the model's: of an offset of a millimetre its error takes micrometres.
        """
        return coil - rotation @ self.coil

    def direction(self, axis: Array, rotation: Array) -> Array:
        """Where the tip points (3,) when the coil's axis is measured as `axis` (3,), the tip's frame being `rotation`.

        The shortest turn in the tip's frame that lays the coil's axis along z. The frame is the model's: of an axis
        askew by 3 degrees its error by one degree takes 0.05 degrees.
        """
        return axis if self.axis is None else rotation @ (self._straighten @ (rotation.T @ axis))

    def coil_axis(self, direction: Array, rotation: Array) -> Array:
        """The other way round: the axis (3,) that was measured when `direction` has made this of it."""
        return direction if self.axis is None else rotation @ (self._straighten.T @ (rotation.T @ direction))

    @cached_property
    def _straighten(self) -> Array:
        """Rotation (3, 3) that carries the coil's axis onto z the short way."""
        x, y, z = np.array([0.0, 0.0, 1.0]) if self.axis is None else self.axis
        part = 1.0 / (1.0 + z)
        return np.array([[1.0 - part * x * x, -part * x * y, -x], [-part * x * y, 1.0 - part * y * y, -y], [x, y, z]])

    def wrenches(self, tared: Array, alpha: Array) -> Array:
        """What the tubes exert (q, 6) of tared readings (q, 6) at rotations alpha (q,) [N, N m]."""
        return self.sensors.exerted(tared, alpha)

    def offset(self, readings: Array, alpha: Array) -> Array:
        """The tare (q, 6) of readings (q, 6) without load: what hangs on the sensors stays in."""
        return readings - self.sensors.hanging(alpha)
