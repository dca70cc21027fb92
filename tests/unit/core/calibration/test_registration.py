"""The registration recovers frames from simulated tracker data of the exact rod."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.calibration.fit import UnobservableCombination
from core.calibration.registration import register
from core.calibration.rigid_transform import RigidTransform
from tests.harness.visited import COIL, NOISE, TRACKER, altered, poses, seen


def far(found: RigidTransform) -> float:
    """Return the mean distance [m] between true and found positions at the corners of the workspace."""
    corners = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (0.1, 0.25)])
    return float(np.linalg.norm(found.apply(TRACKER.inverse().apply(corners)) - corners, axis=1).mean())


@pytest.mark.parametrize("directions", [0, 1, 3])
def test_frames_are_recovered_with_a_coil_of_three_five_and_six_degrees_of_freedom(paper_robot, directions):
    measurements = seen(paper_robot, poses(0, 24), directions=directions)

    found = register(paper_robot, measurements, np.zeros((24, 3)), NOISE)

    assert far(found.frames.registration) < 0.04e-3
    np.testing.assert_allclose(found.frames.coil, COIL, rtol=0, atol=0.1e-3)
    assert 0.5 < found.fit.variance_factor < 1.6
    assert found.rms < 0.06e-3
    assert found.held_out.mean() < 0.08e-3


def test_the_registration_accounts_for_a_load(paper_robot):
    force = np.array([0.4, 0.1, 0.0])
    measurements = seen(paper_robot, poses(1, 20), force)

    found = register(paper_robot, measurements, np.tile(force, (20, 1)), NOISE._replace(force=1e-6))

    assert far(found.frames.registration) < 0.05e-3


def test_wrong_tube_parameters_increase_residuals_and_covariance(paper_robot):
    measurements = seen(altered(paper_robot), poses(2, 24))

    found = register(paper_robot, measurements, np.zeros((24, 3)), NOISE)

    assert found.rms > 0.3e-3
    assert found.fit.variance_factor > 50.0
    assert found.held_out.mean() > 0.3e-3


def test_a_robot_that_only_slides_is_refused_and_the_named_turn_is_sufficient(paper_robot, paper_limits):
    joints = np.tile([0.0, 1.5, -0.1], (12, 1))
    joints[:, 2] = np.linspace(-0.12, -0.02, 12)
    with pytest.raises(
        UnobservableCombination,
        match=r"not determine .*: turn (outer|inner)_rotation by \d+ deg in both directions \(it turned 0\.0 deg",
    ) as refusal:
        register(paper_robot, seen(paper_robot, joints), np.zeros((12, 3)), NOISE, paper_limits)
    name, amount = str(refusal.value).split(": turn ")[1].split(" by ")
    turn = np.radians(float(amount.split()[0]))
    more = joints.copy()
    more[:, ["outer_rotation", "inner_rotation"].index(name)] += np.tile([turn, -turn], 6)
    every = np.vstack((joints, more))

    found = register(paper_robot, seen(paper_robot, every), np.zeros((24, 3)), NOISE, paper_limits)

    assert far(found.frames.registration) < 0.5e-3


def test_a_registration_with_too_few_poses_is_refused(paper_robot):
    with pytest.raises(UnobservableCombination, match="5 measurements"):
        register(paper_robot, seen(paper_robot, poses(0, 5)), np.zeros((5, 3)), NOISE)


def test_a_tracker_rotation_about_z_is_equivalent_to_a_zero_error_of_all_tubes(paper_robot):
    """Rotating all tubes by an angle has the same effect on the measurements as rotating the tracker about z."""
    turned = poses(3, 20) + np.array([0.2, 0.2, 0.0])
    measurements = [
        v._replace(joints=joints) for v, joints in zip(seen(paper_robot, turned), poses(3, 20), strict=True)
    ]

    found = register(paper_robot, measurements, np.zeros((20, 3)), NOISE)

    expected = Rotation.from_rotvec([0.0, 0.0, -0.2]).as_matrix() @ TRACKER.rotation
    assert found.rms < 0.06e-3
    np.testing.assert_allclose(found.frames.registration.rotation, expected, rtol=0, atol=1e-3)


def test_the_registration_names_the_best_joint_first_when_no_single_joint_is_sufficient(paper_robot, paper_limits):
    joints = np.tile([0.0, 1.5, -0.1], (12, 1))

    with pytest.raises(UnobservableCombination, match=r"\w+ by \d+ deg in both directions .*, then the other joints"):
        register(paper_robot, seen(paper_robot, joints), np.zeros((12, 3)), NOISE, paper_limits)
