"""Base sensors that are not mounted along their tubes' axes: their wrenches, seen from the tubes' proximal ends."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.devices.config import Mount
from station.devices.interfaces import BaseSensors, Condition, Trouble, WrenchReading


def transport(mount: Mount) -> Array:
    """(6, 6): force and moment about the sensor's origin, in its axes, into those of the frame it stands in.

    f' = R f and m' = R m + p x R f.
    """
    x, y, z = mount.position
    turn, moved = mount.rotation, np.eye(6)
    moved[3:, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    turned = np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = turn
    return moved @ turned


def mounted(sensors: BaseSensors, mounts: Sequence[Mount]) -> BaseSensors:
    """Sensors as they are mounted, one a tube; those that stand as the tubes do are left alone."""
    return sensors if all(mount == Mount() for mount in mounts) else MountedSensors(sensors, mounts)


class MountedSensors:
    """Sensors whose wrenches are transported."""

    def __init__(self, sensors: BaseSensors, mounts: Sequence[Mount]) -> None:
        self._sensors = sensors
        self._transports = np.array([transport(mount) for mount in mounts])

    @property
    def condition(self) -> Condition:
        """The sensors'."""
        return self._sensors.condition

    def connect(self, now: float) -> None:
        """Connect the sensors."""
        self._sensors.connect(now)

    def poll(self, now: float) -> WrenchReading:
        """The newest sample, from the tubes' proximal ends."""
        reading = self._sensors.poll(now)
        wrenches = np.einsum("kij,kj->ki", self._transports, reading.wrenches)
        return WrenchReading(reading.time, wrenches, reading.usable)

    def trouble(self, now: float) -> Trouble | None:
        """The sensors'."""
        return self._sensors.trouble(now)

    def details(self) -> Mapping[str, Any]:
        """The sensors'."""
        return self._sensors.details()

    def close(self) -> None:
        """Let go of the sensors."""
        self._sensors.close()
