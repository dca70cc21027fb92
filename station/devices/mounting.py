"""Transforms wrenches of misaligned base sensors into frames at the tubes' proximal ends."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.devices.config import Mount
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, WrenchReading


def transport(mount: Mount) -> Array:
    """Return the matrix (6, 6) from wrenches in the sensor's frame to wrenches in the frame at the tube's proximal end.

    f' = R f and m' = R m + p x R f, with the position p and the rotation R of the mount.
    """
    x, y, z = mount.position
    rotation, shift = mount.rotation, np.eye(6)
    shift[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    rotated = np.zeros((6, 6))
    rotated[:3, :3] = rotated[3:, 3:] = rotation
    return shift @ rotated


def mounted(sensors: BaseSensors, mounts: Sequence[Mount]) -> BaseSensors:
    """Return sensors with their mounts applied, one per tube; without a mount return the sensors unchanged."""
    return sensors if all(mount == Mount() for mount in mounts) else MountedSensors(sensors, mounts)


class MountedSensors:
    """Sensors whose wrenches are transformed by their mounts."""

    def __init__(self, sensors: BaseSensors, mounts: Sequence[Mount]) -> None:
        self._sensors = sensors
        self._transports = np.array([transport(mount) for mount in mounts])

    @property
    def condition(self) -> Condition:
        """Connection state of the sensors."""
        return self._sensors.condition

    def connect(self, now: float) -> None:
        """Connect the sensors."""
        self._sensors.connect(now)

    def poll(self, now: float) -> WrenchReading:
        """Return the newest sample, in the frames at the tubes' proximal ends."""
        reading = self._sensors.poll(now)
        wrenches = np.einsum("kij,kj->ki", self._transports, reading.wrenches)
        return WrenchReading(reading.time, wrenches, reading.usable)

    def trouble(self, now: float) -> DeviceFault | None:
        """Return the most severe fault of the sensors, or None."""
        return self._sensors.trouble(now)

    def details(self) -> Mapping[str, Any]:
        """Return identity and counters of the sensors."""
        return self._sensors.details()

    def close(self) -> None:
        """Close the sensors."""
        self._sensors.close()
