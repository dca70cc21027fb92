"""The coil's axis is recovered from many poses, and implausible results are refused."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.coil_axis import coil_axis


@pytest.fixture
def tips() -> Rotation:
    return Rotation.random(40, np.random.default_rng(3))


@pytest.mark.parametrize("angle", [0.0, 3.0, 40.0])
def test_a_misaligned_coil_axis_is_found_with_its_spread(tips, angle):
    true = Rotation.from_euler("zy", [70.0, angle], degrees=True).apply([0.0, 0.0, 1.0])
    noise = 0.01 * np.random.default_rng(4).standard_normal((40, 3))
    measured = (Rotation.from_rotvec(noise) * tips).apply(true)

    found = coil_axis(tips.as_matrix(), measured)

    assert np.linalg.norm(found.direction) == pytest.approx(1.0)
    assert math.acos(min(found.direction @ true, 1.0)) < 4.0 * 0.01 / math.sqrt(40)
    assert math.degrees(found.misalignment) == pytest.approx(angle, abs=0.4)
    assert found.spread == pytest.approx(0.01, rel=0.25)
    assert not found.refused


def test_a_model_that_bends_too_much_appears_as_a_misaligned_coil(tips):
    """An equal rotation of all tip frames causes no spread; only an accurate model separates it from the coil's."""
    modelled = tips * Rotation.from_euler("x", -2.0, degrees=True)

    found = coil_axis(modelled.as_matrix(), tips.apply([0.0, 0.0, 1.0]))

    assert math.degrees(found.misalignment) == pytest.approx(2.0)
    assert found.spread == pytest.approx(0.0, abs=1e-9)


def test_poses_with_inconsistent_coil_axes_are_refused(tips):
    noise = 0.05 * np.random.default_rng(4).standard_normal((40, 3))

    found = coil_axis(tips.as_matrix(), (Rotation.from_rotvec(noise) * tips).apply([0.0, 0.0, 1.0]))

    assert "the model does not bend like the robot" in found.refused


def test_a_coil_that_points_backward_is_refused(tips):
    found = coil_axis(tips.as_matrix(), tips.apply([0.0, 0.0, -1.0]))

    assert found.refused.startswith("more than 45 deg: the coil is mounted backwards")
