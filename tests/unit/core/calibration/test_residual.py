"""Wind-up by friction, and classification of a residual: friction, smooth, or neither."""

import numpy as np
import pytest

from core.calibration.residual import (
    PATH_POSES,
    PoseErrors,
    direction_states,
    fit_residual,
    paths,
    predict_residual,
    residual,
    wind_ups,
)
from station.config.robots import load_robot

HALF_LAGS = np.array([0.08, 0.0])


@pytest.fixture
def robot():
    return load_robot("nylon").robot()


def inner_turned(*angles: float) -> np.ndarray:
    """Return joint positions of the nylon robot: the inner tube turns to the given angles [rad] in sequence."""
    return np.array([[0.0, -0.08, angle, -0.11] for angle in angles])


@pytest.mark.parametrize(
    ("angles", "wound", "error"),
    [
        ((0.0, 2.0, 0.0, 1.0, 1.0), [0.0, 0.08, -0.08, 0.08, 0.08], 1e-6),  # by the half lag, in its direction
        ((0.0, 1e-3, 2e-3), [0.0, 1e-3, 2e-3], 3e-5),  # so short that the far end does not move
    ],
)
def test_a_rotation_winds_a_tube_up_to_its_half_lag(robot, angles, wound, error):
    np.testing.assert_allclose(wind_ups(robot, paths(inner_turned(*angles)), HALF_LAGS)[:, 0], wound, atol=error)


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
    directions, labels = direction_states(robot, history), np.arange(120) // 24
    found = residual(PoseErrors(robot, joints, directions, np.zeros((120, 3)), errors, labels))

    assert found.kind == kind
    assert (found.learned < 0.5 * found.mean) == (kind != "neither")


def test_the_direction_state_of_a_joint_follows_dahls_law_with_the_half_lag_of_its_distance(robot):
    random = np.random.default_rng(3)
    history = paths(np.cumsum(random.normal(0.0, [0.0, 0.0, 0.1, 1e-3], (40, 4)), axis=0))
    states, wound = direction_states(robot, history), wind_ups(robot, history, np.array([0.05, 0.05]))

    np.testing.assert_allclose(states[:, 2], wound[:, 0] / 0.05, atol=1e-12)


def poses_of(robot, count: int, seed: int) -> PoseErrors:
    """Return poses with a smooth error that turns with the robot, depends on the load and on the last motion."""
    random = np.random.default_rng(seed)
    joints = np.column_stack([
        random.uniform(-3.0, 3.0, count), np.full(count, -0.08), random.uniform(-3.0, 3.0, count),
        random.uniform(-0.14, -0.11, count),
    ])  # fmt: skip
    forces, states = random.normal(0.0, 0.1, (count, 3)), direction_states(robot, paths(joints))
    bend, c, s = joints[:, 2] - joints[:, 0], np.cos(joints[:, 0]), np.sin(joints[:, 0])
    along = 1e-3 * np.cos(bend) + 0.5e-3 * states[:, 2] + 2e-3 * (c * forces[:, 0] + s * forces[:, 1])
    errors = np.column_stack((c * along, s * along, 0.3e-3 * np.sin(bend)))
    errors += 0.02e-3 * random.standard_normal((count, 3))
    return PoseErrors(robot, joints, states, forces, errors, np.arange(count) // 20)


def test_a_fitted_residual_predicts_trajectories_that_it_has_not_seen(robot):
    found, new = fit_residual(poses_of(robot, 300, 1)), poses_of(robot, 100, 2)
    values, shares = predict_residual(found, new)

    assert np.linalg.norm(new.errors - values, axis=1).mean() < 0.4 * np.linalg.norm(new.errors, axis=1).mean()
    assert shares.min() > 0.5


def test_far_from_its_data_a_residual_is_zero(robot):
    found, new = fit_residual(poses_of(robot, 200, 1)), poses_of(robot, 20, 2)
    values, shares = predict_residual(found, new._replace(joints=new.joints + np.array([0.0, 0.0, 0.0, 0.5])))

    assert shares.max() < 0.05
    assert not values.any()


def test_no_residual_is_fitted_to_noise_or_to_few_poses(robot):
    poses = poses_of(robot, 100, 1)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((100, 3))

    assert fit_residual(poses.of(np.arange(10))) is None
    found = fit_residual(poses._replace(errors=noise))
    assert np.linalg.norm(predict_residual(found, poses_of(robot, 50, 2))[0], axis=1).max() < 0.3e-3
