"""Residuals at the true parameters are noise, and their derivatives match central differences."""

import numpy as np
import pytest

from core.calibration.prediction import Frames, Prediction
from core.calibration.quantities import quantities
from tests.harness.visited import COIL, NOISE, TRACKER, poses, seen

FORCE = np.array([0.3, -0.1, 0.05])


@pytest.fixture
def problem(paper_robot):
    def make(directions: int) -> Prediction:
        measurements = seen(paper_robot, poses(4, 6), FORCE, directions=directions)
        frames = Frames(TRACKER, COIL, np.zeros(3))
        return Prediction(paper_robot, quantities(paper_robot), measurements, np.tile(FORCE, (6, 1)), NOISE, frames)

    return make


@pytest.mark.parametrize("directions", [0, 1, 3])
def test_prediction_residuals_at_the_true_parameters_are_noise(problem, directions):
    found = problem(directions)
    residuals = found.residuals(np.zeros(len(found.parameters)))

    assert residuals.size == 18 * (1 + directions)
    assert np.sqrt(np.mean(residuals**2)) < 1.4
    assert np.abs(found.errors(np.zeros(len(found.parameters)))).max() < 4.0 * NOISE.coil


@pytest.mark.parametrize("directions", [0, 1, 3])
def test_the_prediction_jacobian_matches_central_differences(problem, directions):
    found = problem(directions)
    sizes = np.array([parameter.size for parameter in found.parameters])
    at = 0.05 * sizes * np.random.default_rng(1).standard_normal(sizes.size)

    jacobian = found.jacobian(at)

    for k, size in enumerate(sizes):
        half = np.zeros_like(at)
        half[k] = 1e-4 * size
        expected = (found.residuals(at + half) - found.residuals(at - half)) / (2.0 * half[k])
        np.testing.assert_allclose(jacobian[:, k], expected, rtol=0, atol=3e-5 * np.abs(expected).max())


def test_an_uncertain_force_has_less_weight_where_the_robot_is_compliant(paper_robot):
    measurements = seen(paper_robot, np.array([[0.0, 1.5, -0.12], [0.0, 1.5, -0.02]]), FORCE)
    frames = Frames(TRACKER, COIL, np.zeros(3))
    found = Prediction(paper_robot, (), measurements, np.tile(FORCE, (2, 1)), NOISE._replace(force=0.02), frames)
    # the derivatives by the frame's position are the weights
    rows = found.jacobian(np.zeros(9))[:, 3:6].reshape(2, 3, 3)

    assert np.linalg.det(rows[0]) > 10.0 * np.linalg.det(rows[1])
