"""Targets, hands and the cloud of reachable tips, on the model."""

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile, load_robot
from web.scene.gizmos import LOWER, MOST_FORCE, UPPER, boxes, pull
from web.scene.scene import ARROW, UNIT
from web.scene.target import STAY, way_to
from web.scene.workspace import reachable_tips

POSE = np.array([0.0, np.pi / 2, -0.1])
NOTHING = np.zeros(3)


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return load_robot("paper")


@pytest.fixture(scope="module")
def statics(robot: RobotFile) -> Statics:
    return Statics(robot.robot())


def test_a_near_place_is_reached_by_waypoints_that_end_there(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = way_to(tip + np.array((0.008, 0.0, -0.004)), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is not None
    time = way.motion.points[-1][0]
    end = way.motion.trajectory().setpoint(time + 1.0).position
    np.testing.assert_allclose(end, (0.008, 0.0, -0.004), atol=1e-12)
    assert way.duration == pytest.approx(time + STAY, abs=0.1)


def test_where_the_joints_are_too_slow_the_way_takes_longer(robot: RobotFile, statics: Statics) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    easy, hard = (
        way_to(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
        for offset in ((0.01, 0.0, 0.0), (0.0, 0.01, 0.01))
    )
    assert easy.motion is not None
    assert hard.motion is not None
    assert hard.duration > easy.duration


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.5), (0.2, 0.0, 0.0), (0.0, 0.0, 1e3), (np.nan, 0.0, 0.0)])
def test_a_far_place_is_out_of_reach_with_a_reason(robot: RobotFile, statics: Statics, offset: Array) -> None:
    tip = statics.solve(POSE, np.zeros(6)).tip
    way = way_to(tip + np.array(offset), statics, robot.limits(), POSE, tip, NOTHING)
    assert way.motion is None
    assert way.reason


def test_the_load_that_is_on_counts(robot: RobotFile, statics: Statics) -> None:
    force = np.array([0.3, 0.0, 0.0])
    loaded = statics.solve(POSE, np.concatenate((force, np.zeros(3)))).tip
    assert way_to(loaded, statics, robot.limits(), POSE, loaded, force).motion is not None


def test_a_hand_pulls_along_the_arrow_and_not_too_hard() -> None:
    tip = np.array([0.02, -0.04, 0.19])
    np.testing.assert_allclose(pull(tip + ARROW * np.array((0.1, 0.2, 0.0)), tip, ARROW), (0.1, 0.2, 0.0))
    assert np.linalg.norm(pull(tip + np.array((9.0, 0.0, 0.0)), tip, ARROW)) == pytest.approx(MOST_FORCE)
    np.testing.assert_allclose(pull(tip, tip, ARROW), 0.0)


def test_every_reachable_tip_can_be_targeted(robot: RobotFile, statics: Statics) -> None:
    tips = reachable_tips(statics, robot.limits(), 500)
    assert len(tips) > 400
    assert (tips > LOWER).all()
    assert (tips < UPPER).all()
    assert all(box.holds(tuple(UNIT * tip)) for box in boxes(UNIT).values() for tip in tips)
    # The tubes' lengths bound how far a tip can be from the plate.
    assert np.linalg.norm(tips, axis=1).max() < 0.303
