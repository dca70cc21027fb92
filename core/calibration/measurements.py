"""Measurements of the robot at rest at one pose: averages of the devices' data, and their standard deviations."""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array


class Measurement(NamedTuple):
    """Averages of the devices' data at one pose at rest; no value comes from a model."""

    time: float  #: time of the middle of the averaged data [s]
    joints: Array  #: (n,) positions that the stages report [rad or m]
    coil: Array  #: (3,) position of the coil in the tracker's frame [m]
    wrenches: Array  #: (s, 6) untared readings of the base sensors in their axes [N, N m]
    weight: float | None  #: known weight at the tip [N]; 0: no load; None: unknown load
    came: Array | None = None  #: (n,) direction of each joint's last motion (-1, 0, 1), for the backlash
    axes: Array | None = None  #: (1, 3) or (3, 3) directions of the coil, tracker's frame: its axis, or x, y, z
    path: Array | None = None  #: (p, n) joints of the previous poses and this one, oldest first [rad or m]


class Noise(NamedTuple):
    """Standard deviations of a measurement's averages."""

    coil: float = 0.02e-3  #: standard deviation of each axis of the coil's position [m]
    axes: float = 2e-3  #: standard deviation of each component of a coil direction [rad]
    force: float = 2e-3  #: standard deviation of each component of the summed force [N]
    moment: float = 0.1e-3  #: standard deviation of each component of the summed moment [N m]

    def scaled(self, factor: float) -> "Noise":
        """Return all standard deviations times `factor`."""
        return Noise(*(factor * each for each in self))


def stacked(measurements: list[Measurement]) -> tuple[Array, Array]:
    """Return the joints (m, n) and coil positions (m, 3) of measurements as arrays."""
    return np.array([v.joints for v in measurements]), np.array([v.coil for v in measurements])
