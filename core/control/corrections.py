"""Corrections from a calibration, applied to every sample: coil position, coil axis, and errors of the base sensors."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from core.control.sensors import Sensors
from core.robot.robot import Array


@dataclass(frozen=True)
class Corrections:
    """Calibrated offset and axis of the tracker coil, and calibrated base sensors."""

    sensors: Sensors
    #: (3,) position of the coil in the frame of the innermost tube's tip [m]
    coil: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array | None = None  #: (3,) coil axis in the tip's frame, unit vector; None: it is parallel to the tip

    def tip(self, coil: Array, rotation: Array) -> Array:
        """Return the tip (3,) for a coil measured at `coil` (3,) [m]; `rotation` (3, 3) is the tip's frame.

        The tip's frame comes from the model. With a coil offset of a millimetre, an error of this frame moves the tip
        by micrometres.
        """
        return coil - rotation @ self.coil

    def direction(self, axis: Array, rotation: Array) -> Array:
        """Return the tip's direction (3,) for a measured coil axis `axis` (3,); `rotation` (3, 3) is the tip's frame.

        The correction is the shortest rotation in the tip's frame that turns the coil's axis to z. The tip's frame
        comes from the model. With a coil axis misaligned by 3 degrees, a frame error of one degree causes a direction
        error of 0.05 degrees.
        """
        return axis if self.axis is None else rotation @ (self._straighten @ (rotation.T @ axis))

    def coil_axis(self, direction: Array, rotation: Array) -> Array:
        """Return the coil axis (3,) measured when the tip points along `direction`: inverse of `direction()`."""
        return direction if self.axis is None else rotation @ (self._straighten.T @ (rotation.T @ direction))

    @cached_property
    def _straighten(self) -> Array:
        """Shortest rotation (3, 3) that turns the coil's axis to the z axis of the tip's frame."""
        x, y, z = np.array([0.0, 0.0, 1.0]) if self.axis is None else self.axis
        part = 1.0 / (1.0 + z)
        return np.array([[1.0 - part * x * x, -part * x * y, -x], [-part * x * y, 1.0 - part * y * y, -y], [x, y, z]])

    def wrenches(self, tared: Array, alpha: Array) -> Array:
        """Return the tubes' wrenches (q, 6) [N, N m] from tared readings (q, 6) at rotations alpha (q,)."""
        return self.sensors.exerted(tared, alpha)

    def offset(self, readings: Array, alpha: Array) -> Array:
        """Return the tare (q, 6) from readings (q, 6) without load.

        The tare excludes the weight of parts that hang on the sensors, because the sensors rotate relative to gravity.
        """
        return readings - self.sensors.hanging(alpha)
