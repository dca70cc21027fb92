"""`ctr-station ik`: every printed pose has the tip at the point, within the limits."""

import json
import math

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from station.config.robots import load_robot
from station.config.strict import PRESETS

POSES = {
    "paper": [0.4, 1.1, -0.06],
    "three_tubes": [0.3, 1.2, -0.5, -0.10, -0.18, -0.26],
    "balanced_pair": [0.2, 1.0, 2.0, -0.05, -0.08, -0.13],
}


def solved(robot, joints, force=(0.0, 0.0, 0.0)):
    return ExactRod(robot).solve(np.array(joints), np.array([*force, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize("name", POSES)
@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.01)])
def test_every_pose_is_within_the_travel_and_has_the_tip_at_the_point_by_the_exact_rod(call, name, force):
    file = load_robot(name)
    robot, limits = file.robot(), file.limits()
    tip = solved(robot, POSES[name], force).tip
    done = call("ik", name, "--tip", *map(repr, tip.tolist()), "--force", *map(str, force), "--json")
    found = json.loads(done.out)["solutions"]
    assert done.status == 0
    assert len(found) > 1
    for one in found:
        joints = [one["joints"][joint] for joint in robot.joint_names]
        limits.check(np.array(joints))
        assert np.linalg.norm(solved(robot, joints, force).tip - tip) < 0.3e-3  # 0.1 mm, and the model's error
    turns = [[math.cos(one["joints"][joint]) for joint in robot.joint_names] for one in found]
    assert len(np.unique(np.round(turns, 4), axis=0)) > 1  # different poses, not whole turns of one


def test_six_joints_reach_a_point_in_a_direction(call):
    robot = load_robot("three_tubes").robot()
    aim = solved(robot, POSES["three_tubes"])
    tip, direction = (",".join(map(repr, part.tolist())) for part in (aim.tip, aim.rotation[:, 2]))
    done = call("ik", "three_tubes", f"--tip={tip}", f"--direction={direction}", "--json")
    assert done.status == 0
    for one in json.loads(done.out)["solutions"]:
        joints = [one["joints"][joint] for joint in robot.joint_names]
        found = solved(robot, joints)
        assert np.linalg.norm(found.tip - aim.tip) < 0.15e-3
        assert np.linalg.norm(found.rotation[:, 2] - aim.rotation[:, 2]) < 3e-3


def test_a_point_out_of_reach_gets_the_nearest_pose_with_its_limit(call):
    done = call("ik", "paper", "--tip", "0.1", "-0.1", "0.4")
    assert done.status == 1
    assert "No pose within the limits reaches the point" in done.out
    assert "travel of inner_translation (-0.005 m)" in done.out


@pytest.mark.parametrize("required", [False, True])
def test_a_point_near_the_plate_needs_a_retracted_tip_where_the_limits_permit_one(call, write, required):
    text = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8").replace("lower = -0.130", "lower = -0.250")
    robot = write(f"ends_in_order = {str(required).lower()}\n{text}")
    done = call("ik", str(robot), "--tip", "0.0", "-0.01", "0.09", "--tolerance", "5")
    assert (done.status == 0) is not required
    assert ("ends inside another tube" in done.out) is not required


@pytest.mark.parametrize("option", [["--tip", "0", "0"], ["--tip", "0,0,x"], ["--tip", "0", "0", "99"]])
def test_three_numbers_are_required(call, option):
    done = call("ik", "paper", *option)
    assert done.status == 2
    assert "expected three numbers X Y Z from -10 to 10 m" in done.err
