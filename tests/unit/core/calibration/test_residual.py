"""Wind-up by friction, and classification of a residual: friction, smooth, or neither."""

import numpy as np
import pytest

from core.calibration.residual import PATH_POSES, paths, residual, turned_tubes, wind_ups
from station.config.robots import load_robot

HALF_LAGS = np.array([0.08, 0.0])


@pytest.fixture
def robot():
    return load_robot("nylon").robot()


def inner_turned(*angles: float) -> np.ndarray:
    """Return joint positions of the nylon robot: the inner tube turns to the given angles [rad] in sequence."""
    return np.array([[0.0, -0.08, angle, -0.11] for angle in angles])


def test_a_long_rotation_winds_a_tube_up_by_its_half_lag_in_the_direction_of_the_rotation(robot):
    found = wind_ups(robot, paths(inner_turned(0.0, 2.0, 0.0, 1.0, 1.0)), HALF_LAGS)[:, 0]

    np.testing.assert_allclose(found, [0.0, 0.08, -0.08, 0.08, 0.08], atol=1e-6)


def test_a_rotation_much_shorter_than_the_half_lag_does_not_move_the_far_end(robot):
    found = wind_ups(robot, paths(inner_turned(0.0, 1e-3, 2e-3)), HALF_LAGS)[:, 0]

    np.testing.assert_allclose(found, [0.0, 1e-3, 2e-3], atol=3e-5)


def test_a_rotating_outer_tube_winds_up_the_inner_one_in_the_opposite_direction(robot):
    turned = np.array([[0.0, -0.08, 0.0, -0.11], [1.0, -0.08, 0.0, -0.11]])

    assert wind_ups(robot, paths(turned), HALF_LAGS)[1, 0] == pytest.approx(-0.08, abs=1e-6)


def test_motion_paths_contain_the_last_poses_and_are_padded_with_the_first_pose():
    joints = np.arange(40.0)[:, None]

    assert paths(joints).shape == (40, PATH_POSES, 1)
    np.testing.assert_array_equal(paths(joints)[-1, :, 0], joints[-PATH_POSES:, 0])
    np.testing.assert_array_equal(paths(joints)[0, :, 0], np.zeros(PATH_POSES))


@pytest.mark.parametrize("kind", ["friction", "smooth", "neither"])
def test_a_residual_is_classified_by_what_predicts_it_at_held_out_poses(robot, kind):
    random = np.random.default_rng(7)
    joints = np.column_stack([random.uniform(-1.5, 1.5, 120), np.full(120, -0.08), *np.zeros((2, 120))])
    joints[:, 2], joints[:, 3] = random.uniform(-1.5, 1.5, 120), random.uniform(-0.14, -0.11, 120)
    history, errors = paths(joints), 0.02e-3 * random.standard_normal((120, 3))
    if kind == "friction":
        wound = wind_ups(robot, history, HALF_LAGS)[:, 0]
        errors += 3e-3 * wound[:, None] * np.column_stack((np.cos(joints[:, 2]), np.sin(joints[:, 2]), np.ones(120)))
    elif kind == "smooth":
        errors[:, 0] += 0.2e-3 * np.sin(joints[:, 2] - joints[:, 0])
    found = residual(robot, joints, errors, history, turned_tubes(robot))

    assert found.kind == kind
    assert (found.learned < 0.5 * found.mean) == (kind != "neither")
