"""Residuals at the true parameters are noise, and their derivatives match central differences."""

import numpy as np
import pytest

from core.calibration.measurements import Measurement
from core.calibration.prediction import Frames, Prediction, predict
from core.calibration.quantities import quantities
from core.model.cosserat import ExactRod
from core.robot.robot import Joint, Robot, Section, Tube
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


def test_ordered_measurements_follow_the_shape_of_the_one_before():
    """Past half a turn of a pair that snaps, the exact rod in short steps gives the followed shape."""
    sections = (Section(0.2), Section(0.1, (12.0, 0.0)))
    robot = Robot(
        "pair",
        (
            Tube("inner", sections, 0.01, 0.3, 1.0e-3, 0.8e-3, translation=-0.2),
            Tube("outer", sections, 0.01, 0.3, 1.4e-3, 1.1e-3, translation=-0.2),
        ),
        (Joint("turn", 0, "rotation"),),
    )
    turns = np.linspace(0.0, 3.5, 15)[:, None]
    rod, exact, tips = None, ExactRod(robot), []
    for turn in turns:
        rod = exact.solve(turn, np.zeros(6), rod)
        tips.append(rod.tip)
    empty = np.zeros((2, 6))
    ordered = [Measurement(0.0, turn, np.zeros(3), empty, 0.0, path=turns) for turn in turns]
    unordered = [measurement._replace(path=None) for measurement in ordered]
    jumping = [ordered[k] for k in (0, 14, 1, 2)]
    forces = np.zeros((15, 3))

    assert np.abs(predict(robot, ordered, forces).tip - tips).max() < 0.1e-3
    assert np.linalg.norm(predict(robot, unordered, forces).tip[-1] - tips[-1]) > 10e-3
    jumped, rest = predict(robot, jumping, forces[:4]).tip, predict(robot, unordered, forces).tip
    np.testing.assert_allclose(jumped, rest[[0, 14, 1, 2]], rtol=0, atol=1e-6)
