"""Points along the tubes and their Jacobians against solved shapes at moved joints."""

import numpy as np
import pytest

from core.model.backbone import POINTS, ExpectedMotion, backbone, tip_point
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import load_robot

EXPOSED, RETRACTED = np.array([0.3, 1.57, -0.1]), np.array([0.3, 1.57, -0.2])  # end of the inner tube
WRENCH = np.array([0.2, 0.1, 0.05, 0.0, 0.0, 0.0])


@pytest.fixture(params=["paper", "fourth_order"])
def statics(request: pytest.FixtureRequest) -> Statics:
    robot = load_robot("paper").robot()
    return Statics(robot) if request.param == "paper" else Statics(robot, integrator="fourth_order")


@pytest.mark.parametrize(("joints", "tip"), [(EXPOSED, POINTS - 1), (RETRACTED, POINTS)])
def test_points_are_on_the_shape_and_one_is_the_tip(statics: Statics, joints: Array, tip: int) -> None:
    at = statics.solve(joints, WRENCH)
    found, shape = backbone(statics, at), statics.shape(at)
    length = shape[-1, 0]

    assert tip_point(statics, at) == tip
    assert np.allclose(found.points[tip], at.tip, atol=1e-7)
    assert np.allclose(found.points[0], shape[0, 10:13], atol=1e-12)
    for row in shape:  # each cross-section is nearer to the line through the points than their sagitta
        share = row[0] / length * (POINTS - 1)
        before = min(int(share), POINTS - 2)
        between = found.points[before] + (share - before) * (found.points[before + 1] - found.points[before])
        assert np.linalg.norm(between - row[10:13]) < 1e-4


@pytest.mark.parametrize("pose", [EXPOSED, RETRACTED])
def test_jacobians_are_the_motion_of_solved_shapes(statics: Statics, pose: Array) -> None:
    at = statics.solve(pose, WRENCH)
    found = backbone(statics, at)

    def points(joints: Array) -> Array:
        return backbone(statics, statics.solve(joints, WRENCH, near=at)).points

    for joint, step in enumerate(1e-5 * np.eye(3)):
        expected = (points(at.joints + step) - points(at.joints - step)) / 2e-5
        assert np.allclose(found.jacobian[:, :, joint], expected, atol=5e-6)
    assert np.allclose(found.jacobian[tip_point(statics, at)], at.jacobian[:3], atol=5e-6)


def test_the_end_of_the_outer_tube_moves_with_its_tube(statics: Statics) -> None:
    """The outer tube of the paper's robot does not slide, so its end has the radius of the outer tube."""
    at = statics.solve(EXPOSED, np.zeros(6))
    found = backbone(statics, at)
    end = statics.robot.tube_poses(at.joints)[1][1] + statics.robot.tubes[1].length
    shape = statics.shape(at)

    assert found.radii[POINTS] == pytest.approx(0.5 * statics.robot.tubes[1].outer_diameter)
    nearest = shape[np.abs(shape[:, 0] - end).argmin()]
    assert np.allclose(found.points[POINTS], nearest[10:13], atol=1e-9)


def test_points_beyond_a_retracted_tip_move_as_the_observed_tip_does(statics: Statics) -> None:
    at, offset = statics.solve(RETRACTED, WRENCH), np.array([0.002, -0.001, 0.0005])
    moved = backbone(statics, at, at.tip + offset).points - backbone(statics, at).points
    assert np.allclose(moved[[POINTS - 1, POINTS]], offset)


def test_points_move_to_the_observed_tip_by_the_square_of_their_share() -> None:
    statics = Statics(load_robot("paper").robot())
    at = statics.solve(EXPOSED, WRENCH)
    offset = np.array([0.002, -0.001, 0.0005])
    moved = backbone(statics, at, at.tip + offset).points - backbone(statics, at).points

    assert np.allclose(moved[POINTS - 1], offset)
    middle = (POINTS - 1) // 2
    assert np.allclose(moved[middle], (middle / (POINTS - 1)) ** 2 * offset)


def test_expected_motion_contains_the_travel_of_the_joints_and_the_change_of_the_load(statics: Statics) -> None:
    """Independent value: shapes solved at moved joints under a changed load."""
    at = statics.solve(EXPOSED, WRENCH)
    travel, rate, time = np.array([1e-4, -2e-4, 1e-5]), np.array([0.05, -0.03, 0.02]), 0.01
    found = backbone(statics, at, None, ExpectedMotion(travel, rate, np.zeros(3), time))

    later = np.concatenate((WRENCH[:3] + time * rate, np.zeros(3)))
    pushed = backbone(statics, statics.solve(EXPOSED, later, near=at)).points - found.points
    both = backbone(statics, statics.solve(EXPOSED + travel, later, near=at)).points - found.points
    assert np.linalg.norm(pushed[-2]) > 1e-6
    assert np.allclose(time * found.drift, pushed, atol=3e-7)
    assert np.allclose(found.ahead, both, atol=4e-7)


def test_drift_of_the_tip_moves_the_points_with_their_weights(statics: Statics) -> None:
    at = statics.solve(EXPOSED, WRENCH)
    drift = np.array([0.001, 0.0, -0.002])
    found = backbone(statics, at, None, ExpectedMotion(np.zeros(3), np.zeros(3), drift, 0.0))

    assert np.allclose(found.drift[POINTS - 1], drift)
    assert np.allclose(found.drift[0], 0.0)
