"""The coil's axis from many poses: found as it was put there, and refused where it cannot be right."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.coil_axis import coil_axis


@pytest.fixture
def tips() -> Rotation:
    return Rotation.random(40, np.random.default_rng(3))


@pytest.mark.parametrize("askew", [0.0, 3.0, 40.0])
def test_an_axis_askew_is_found_with_its_spread(tips, askew):
    true = Rotation.from_euler("zy", [70.0, askew], degrees=True).apply([0.0, 0.0, 1.0])
    noise = 0.01 * np.random.default_rng(4).standard_normal((40, 3))
    seen = (Rotation.from_rotvec(noise) * tips).apply(true)

    found = coil_axis(tips.as_matrix(), seen)

    assert np.linalg.norm(found.direction) == pytest.approx(1.0)
    assert math.acos(min(found.direction @ true, 1.0)) < 4.0 * 0.01 / math.sqrt(40)
    assert math.degrees(found.askew) == pytest.approx(askew, abs=0.4)
    assert found.spread == pytest.approx(0.01, rel=0.25)
    assert not found.refused


def test_what_a_model_bends_too_much_looks_like_a_coil_askew(tips):
    """The same turn in every tip's frame: no spread tells it, so a doubtful model must not be asked."""
    modelled = tips * Rotation.from_euler("x", -2.0, degrees=True)

    found = coil_axis(modelled.as_matrix(), tips.apply([0.0, 0.0, 1.0]))

    assert math.degrees(found.askew) == pytest.approx(2.0)
    assert found.spread == pytest.approx(0.0, abs=1e-9)


def test_poses_that_do_not_agree_are_refused(tips):
    noise = 0.05 * np.random.default_rng(4).standard_normal((40, 3))

    found = coil_axis(tips.as_matrix(), (Rotation.from_rotvec(noise) * tips).apply([0.0, 0.0, 1.0]))

    assert "the model does not bend as the robot does" in found.refused


def test_a_coil_that_looks_back_is_refused(tips):
    found = coil_axis(tips.as_matrix(), tips.apply([0.0, 0.0, -1.0]))

    assert found.refused.startswith("more than 45 deg: the coil sits the wrong way round")
