"""The simulated tracker reports the axis of its coil with the configured lateral noise."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.lab.aurora_coil import GENERATOR_POSE, Coil
from station.lab.config import TrackerConfig

TIP = np.array([0.010, -0.020, 0.190])
AXIS = np.array([0.6, 0.0, 0.8])


def axes(noise: float | None, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return axes in the world frame (frames, 3) and positions (frames, 3) [mm] of the frames."""
    coil = Coil(TrackerConfig(direction_noise=noise), np.random.default_rng(3), GENERATOR_POSE)
    measured, positions = [], []
    for number in range(frames):
        coil.advance(number * 0.025, (number + 0.5) * 0.025, TIP, TIP, AXIS, lost=False)
        frame = coil.newest(math.inf)
        assert frame is not None
        w, *xyz = frame.quaternion
        measured.append(GENERATOR_POSE.rotation @ Rotation.from_quat([*xyz, w]).apply([0.0, 0.0, 1.0]))
        positions.append(frame.position)
    return np.array(measured), np.array(positions)


def test_axis_of_the_simulated_coil_has_the_configured_noise_and_its_position_is_unchanged():
    measured, positions = axes(5.2e-3, 1500)
    across = [np.array([0.0, 1.0, 0.0]), np.array([0.8, 0.0, -0.6])]

    for lateral in across:
        assert np.std(measured @ lateral) == pytest.approx(5.2e-3, rel=0.08)
        assert abs(np.mean(measured @ lateral)) < 5e-4
    assert measured @ AXIS == pytest.approx(np.ones(1500), abs=1e-3)
    assert np.array_equal(positions, axes(None, 1500)[1])


def test_axis_of_the_simulated_coil_is_exact_without_noise():
    assert axes(0.0, 3)[0] == pytest.approx(np.tile(AXIS, (3, 1)), abs=1e-12)
