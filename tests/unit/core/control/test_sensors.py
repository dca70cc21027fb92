"""Mounting and hanging weight of the base sensors, compared with scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.control.sensors import Sensors

ALPHA = np.array([0.7, -1.9])
MOUNTING = [Rotation.from_rotvec([0.02, -0.03, 0.4]), Rotation.from_rotvec([-0.05, 0.01, -0.2])]
WEIGHT, MOMENT = np.array([0.2, 0.1]), np.array([[1e-3, 2e-3, 3e-3], [-2e-3, 1e-3, 4e-3]])
DOWN = np.array([0.6, 0.0, 0.8])


@pytest.fixture
def sensors() -> Sensors:
    return Sensors(np.array([m.as_matrix() for m in MOUNTING]), WEIGHT, MOMENT, DOWN)


def reading(exerted: np.ndarray) -> np.ndarray:
    """Return the readings (2, 6) of the sensors for wrenches (2, 6) that act on their tubes."""
    rows = []
    for i in range(2):
        down = Rotation.from_euler("z", ALPHA[i]).inv().apply(DOWN)
        whole = exerted[i] + np.r_[WEIGHT[i] * down, np.cross(MOMENT[i], down)]
        rows.append(np.r_[MOUNTING[i].inv().apply(whole[:3]), MOUNTING[i].inv().apply(whole[3:])])
    return np.array(rows)


def test_wrenches_of_the_tubes_are_recovered_from_sensor_readings(sensors):
    exerted = np.random.default_rng(0).normal(size=(2, 6))

    np.testing.assert_allclose(sensors.exerted(reading(exerted), ALPHA), exerted, rtol=0, atol=1e-12)


def test_sensor_reading_without_a_load_is_the_hanging_weight(sensors):
    np.testing.assert_allclose(sensors.hanging(ALPHA), reading(np.zeros((2, 6))), rtol=0, atol=1e-12)


def test_ideal_sensors_return_the_readings_unchanged():
    wrenches = np.random.default_rng(1).normal(size=(3, 6))

    ideal = Sensors.ideal(3)

    np.testing.assert_array_equal(ideal.exerted(wrenches, np.array([0.1, 0.2, 0.3])), wrenches)
    np.testing.assert_array_equal(ideal.hanging(np.array([0.1, 0.2, 0.3])), np.zeros((3, 6)))
