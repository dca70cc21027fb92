"""The coil's axis as it is measured: noise across it, and none unless the lab tells it."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.lab.aurora.coil import MOUNT, Coil
from station.lab.config import TrackerConfig

TIP = np.array([0.010, -0.020, 0.190])
AXIS = np.array([0.6, 0.0, 0.8])


def axes(noise: float | None, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """What the frames say of axis, in the world (frames, 3), and position (frames, 3) [mm]."""
    coil = Coil(TrackerConfig(direction_noise=noise), np.random.default_rng(3), MOUNT)
    said, places = [], []
    for number in range(frames):
        coil.advance(number * 0.025, (number + 0.5) * 0.025, TIP, TIP, AXIS, lost=False)
        frame = coil.newest(math.inf)
        assert frame is not None
        w, *xyz = frame.quaternion
        said.append(MOUNT.rotation @ Rotation.from_quat([*xyz, w]).apply([0.0, 0.0, 1.0]))
        places.append(frame.position)
    return np.array(said), np.array(places)


def test_the_axis_wobbles_across_itself_by_what_is_said_and_the_position_stays_the_same():
    said, places = axes(5.2e-3, 1500)
    across = [np.array([0.0, 1.0, 0.0]), np.array([0.8, 0.0, -0.6])]

    for way in across:
        assert np.std(said @ way) == pytest.approx(5.2e-3, rel=0.08)
        assert abs(np.mean(said @ way)) < 5e-4
    assert said @ AXIS == pytest.approx(np.ones(1500), abs=1e-3)
    assert np.array_equal(places, axes(None, 1500)[1])


def test_without_noise_it_is_the_axis():
    assert axes(0.0, 3)[0] == pytest.approx(np.tile(AXIS, (3, 1)), abs=1e-12)
