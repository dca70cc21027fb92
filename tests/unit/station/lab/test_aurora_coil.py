"""The coil of the simulated tracker: noise of its direction, and a distortion near metal that the seed determines."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station.lab.aurora_coil import GENERATOR_POSE, VOLUME_MM, Coil, Distortion
from station.lab.config import TrackerConfig

COIL = np.array([0.010, -0.020, 0.190])
AXIS = np.array([0.6, 0.0, 0.8])


def axes(noise: float | None, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return axes in the world frame (frames, 3) and positions (frames, 3) [mm] of the frames."""
    coil = Coil(TrackerConfig(direction_noise=noise), np.random.default_rng(3), GENERATOR_POSE)
    measured, positions = [], []
    for number in range(frames):
        coil.advance(number * 0.025, (number + 0.5) * 0.025, COIL, COIL, AXIS, lost=False)
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


BOX = 1e-3 * np.array(VOLUME_MM)
TIP = np.array([0.020, -0.040, 0.190])


def field(seed: int = 0, rms: float = 0.48e-3) -> Distortion:
    return Distortion.drawn(rms, BOX, np.random.default_rng(seed))


def anywhere(count: int) -> np.ndarray:
    return np.random.default_rng(99).uniform(BOX[:, 0], BOX[:, 1], (count, 3))


@pytest.mark.parametrize("seed", range(2))
def test_tracker_distortion_has_the_configured_rms_over_the_measured_cube(seed):
    errors = field(seed).at(anywhere(20_000))

    assert np.sqrt(np.mean(np.sum(errors**2, axis=1))) == pytest.approx(0.48e-3, rel=0.05)


def test_tracker_distortion_is_smooth():
    positions = anywhere(2000)
    step = 1e-3 * np.eye(3)
    for seed in range(2):
        change = [np.linalg.norm(field(seed).at(positions + s) - field(seed).at(positions), axis=1) for s in step]
        # No wave is shorter than 0.3 m, so over a millimetre the error changes by a small fraction of a millimetre.
        assert np.max(change) < 0.04 * 1e-3


def seen(distortion: float, noise: float = 0.1e-3, tip: np.ndarray = TIP) -> np.ndarray:
    """Return positions of ten frames as the station receives them, world frame (10, 3) [m]."""
    coil = Coil(TrackerConfig(noise=noise, distortion=distortion), np.random.default_rng(5), GENERATOR_POSE)
    frames = []
    for tick in range(125):
        coil.advance(tick * 0.002, (tick + 1) * 0.002, tip, tip, None, lost=False)
        frame = coil.newest((tick + 1) * 0.002 + 1.0)
        if frame is not None and (not frames or frames[-1] is not frame):
            frames.append(frame)
    return np.array(
        [GENERATOR_POSE.rotation @ (1e-3 * np.array(frame.position)) + GENERATOR_POSE.position for frame in frames[:10]]
    )


def test_measured_coil_position_has_the_distortion_and_unchanged_noise():
    straight, bent = seen(0.0), seen(0.48e-3)

    assert straight == pytest.approx(np.tile(TIP, (10, 1)), abs=1e-3)
    # Every frame has the same distortion, except for its small change over the distance of the noise.
    assert bent - straight == pytest.approx(np.tile((bent - straight)[0], (10, 1)), abs=2e-5)
    assert 0.05e-3 < np.linalg.norm((bent - straight)[0]) < 2e-3
