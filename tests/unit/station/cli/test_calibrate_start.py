"""Choice of the start pose of a calibration."""

import numpy as np
import pytest

from station.cli.calibrate import robot_start
from station.config.robots import load_robot
from station.config.strict import ConfigError


@pytest.mark.parametrize("name", ["paper", "nylon", "three_tubes", "balanced_pair"])
def test_start_pose_of_a_calibration_is_the_working_pose(name: str):
    robot = load_robot(name)
    assert robot.working_pose is not None
    assert robot_start(robot).tolist() == [robot.working_pose[joint.name] for joint in robot.joints]


def test_calibration_without_a_working_pose_starts_at_the_middle_of_each_travel():
    robot = load_robot("balanced_pair").model_copy(update={"working_pose": None})
    np.testing.assert_allclose(robot_start(robot), [0.0, 0.0, 0.0, -0.025, -0.085, -0.1425])


def test_calibration_requests_a_working_pose_if_the_middle_of_the_travel_is_invalid():
    robot = load_robot("balanced_pair")
    joints = [j.model_copy(update={"lower": -0.2}) if j.name == "middle_translation" else j for j in robot.joints]
    robot = robot.model_copy(update={"working_pose": None, "joints": tuple(joints), "ends_in_order": True})

    with pytest.raises(ConfigError, match=r"'balanced_pair' has no working_pose, and the middle of its travel is"):
        robot_start(robot)
