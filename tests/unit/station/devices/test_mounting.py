"""Wrenches of misaligned sensors, compared with forces at points of the tube."""

import math

import numpy as np
import pytest

from station.devices.config import Mount, mounted, transport
from station.devices.interfaces import WrenchReading


@pytest.mark.parametrize("seed", range(5))
def test_transformed_wrench_matches_the_force_at_the_same_point(seed):
    """The sensor's wrench of a force, transformed to the tube's end, must equal the wrench of this force there."""
    random = np.random.default_rng(seed)
    position, vector, point, force = random.uniform(-0.1, 0.1, 3), random.uniform(-2, 2, 3), *random.normal(size=(2, 3))
    mount = Mount(position=tuple(position.tolist()), rotation_vector=tuple(vector.tolist()))
    turn = _by_series(vector)
    own_force, own_point = turn.T @ force, turn.T @ (point - position)
    felt = np.concatenate([own_force, np.cross(own_point, own_force)])

    assert transport(mount) @ felt == pytest.approx(np.concatenate([force, np.cross(point, force)]), abs=1e-12)


def _by_series(vector: np.ndarray) -> np.ndarray:
    """Return the exponential of the cross product's matrix, term by term."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    term = total = np.eye(3)
    for k in range(1, 40):
        term = term @ cross / k
        total = total + term
    return total


class Steady:
    """Sensors with constant readings."""

    def __init__(self, wrenches: np.ndarray, usable: bool = True) -> None:
        self.reading = WrenchReading(1.5, wrenches, usable)

    def poll(self, now: float) -> WrenchReading:
        return self.reading


def test_each_sensor_is_transformed_by_its_mount_only():
    sensors = Steady(np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]] * 2), usable=False)
    reading = mounted(sensors, [Mount(rotation_vector=(0.0, 0.0, math.pi / 2)), Mount(position=(0.0, 0.0, 0.02))]).poll(
        2.0
    )

    assert reading.wrenches[0] == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert reading.wrenches[1] == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.02, 0.0])
    assert (reading.time, reading.usable) == (1.5, False)


def test_sensors_without_a_mount_are_returned_unchanged():
    sensors = Steady(np.zeros((2, 6)))
    assert mounted(sensors, [Mount(), Mount()]) is sensors
