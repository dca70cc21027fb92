"""Inverse kinematics for ROS 2: with five joints or more it also has the direction."""

import numpy as np
import pytest

from core.model.statics import Statics
from station.config.robots import load_robot, named_pose
from station.recording.drawing import quaternion_of
from web.gateway.crtk_services import services


@pytest.mark.parametrize(("name", "has_direction"), [("paper", False), ("three_tubes", True)])
def test_the_pose_has_the_requested_point_and_with_five_joints_the_direction(name, has_direction):
    file = load_robot(name)
    start = named_pose(file.working_pose, file, "working_pose")
    model = Statics(file.robot())
    aim = model.solve(start + 0.02 * file.limits().speed, np.zeros(6))
    answer = services(file, tuple)["inverse_kinematics"].answer
    joints, found, text = answer(((aim.tip.tolist(), quaternion_of(aim.rotation)), start.tolist()))
    assert found, text
    assert bool(text) is not has_direction
    at = model.solve(np.array(joints), np.zeros(6))
    assert at.tip == pytest.approx(aim.tip, abs=1e-5)
    if has_direction:
        assert at.rotation[:, 2] == pytest.approx(aim.rotation[:, 2], abs=3e-4)
    _, found, text = answer(((aim.tip.tolist(), (0.0,) * 4), start.tolist()))
    assert found is not has_direction  # an orientation that counts must be one
