"""A tracker near metal: where it shows the tip, and that it is the same field for the same seed."""

import numpy as np
import pytest

from station.lab.aurora.coil import MOUNT, VOLUME, Coil
from station.lab.aurora.distortion import Distortion
from station.lab.config import TrackerConfig

BOX = 1e-3 * np.array(VOLUME)
TIP = np.array([0.020, -0.040, 0.190])


def field(seed: int = 0, rms: float = 0.48e-3) -> Distortion:
    return Distortion.drawn(rms, BOX, np.random.default_rng(seed))


def anywhere(count: int) -> np.ndarray:
    return np.random.default_rng(99).uniform(BOX[:, 0], BOX[:, 1], (count, 3))


@pytest.mark.parametrize("seed", range(5))
def test_the_error_has_the_wanted_rms_over_the_measured_cube(seed):
    errors = field(seed).at(anywhere(20_000))

    assert np.sqrt(np.mean(np.sum(errors**2, axis=1))) == pytest.approx(0.48e-3, rel=0.05)


def test_the_field_is_smooth():
    places = anywhere(2000)
    step = 1e-3 * np.eye(3)
    for seed in range(5):
        change = [np.linalg.norm(field(seed).at(places + s) - field(seed).at(places), axis=1) for s in step]
        # no wave is shorter than 0.3 m: over a millimetre the error changes by little of a millimetre
        assert np.max(change) < 0.04 * 1e-3


def test_another_seed_bends_it_otherwise():
    assert not np.allclose(field(0).at(TIP), field(1).at(TIP), atol=1e-5)
    assert np.array_equal(field(0).at(TIP), field(0).at(TIP))


def seen(distortion: float, noise: float = 0.1e-3, tip: np.ndarray = TIP) -> np.ndarray:
    """Positions of ten frames as the station gets them, world frame (10, 3) [m]."""
    coil = Coil(TrackerConfig(noise=noise, distortion=distortion), np.random.default_rng(5), MOUNT)
    frames = []
    for tick in range(125):
        coil.advance(tick * 0.002, (tick + 1) * 0.002, tip, tip, None, lost=False)
        frame = coil.newest((tick + 1) * 0.002 + 1.0)
        if frame is not None and (not frames or frames[-1] is not frame):
            frames.append(frame)
    return np.array([MOUNT.rotation @ (1e-3 * np.array(frame.position)) + MOUNT.position for frame in frames[:10]])


def test_the_coil_is_shown_where_the_field_puts_it_and_the_noise_stays_the_same():
    straight, bent = seen(0.0), seen(0.48e-3)

    assert straight == pytest.approx(np.tile(TIP, (10, 1)), abs=1e-3)
    # the same error in every frame up to its change over the noise
    assert bent - straight == pytest.approx(np.tile((bent - straight)[0], (10, 1)), abs=2e-5)
    assert 0.05e-3 < np.linalg.norm((bent - straight)[0]) < 2e-3


def test_a_straight_field_shows_the_tip_itself():
    assert seen(0.0, noise=0.0) == pytest.approx(np.tile(TIP, (10, 1)), abs=1e-12)
