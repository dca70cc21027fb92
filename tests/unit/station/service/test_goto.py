"""Motions to joint-space poses: the working pose of each robot, and refusals before a motion starts."""

import numpy as np
import pytest

from core.errors import CtrError
from station.config.controllers import DEFAULT_CONTROLLER
from station.config.motions import CircleMotion, HelixMotion, Orders, SinusoidMotion, TipMotion, WaypointsMotion
from station.config.robots import load_robot, named_pose
from station.config.strict import preset_names
from station.service.goto import check_path, goto_joints, goto_working_pose
from station.service.station_file import load_station

#: Motions that the page and the README propose.
MOTIONS = [
    CircleMotion(radius=0.01, period=20.0),
    HelixMotion(radius=0.008, pitch=0.003, turn=20.0, turns=3.0),
    SinusoidMotion(amplitude=0.01, frequency=0.05),
    SinusoidMotion(amplitude=0.01, frequency=0.05, direction=(1.0, 0.0, 0.0)),
    SinusoidMotion(amplitude=0.01, frequency=0.05, direction=(0.0, 1.0, 0.0)),
    WaypointsMotion(points=((5.0, 0.0, 0.01, 0.0), (10.0, 0.0, 0.0, 0.0))),
]


@pytest.fixture(scope="module", params=preset_names("robots"))
def name(request):
    return request.param


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.kind)
def test_motion_can_start_at_the_working_pose(name: str, motion: TipMotion):
    robot = load_robot(name)
    controller = DEFAULT_CONTROLLER.controller(robot)
    assert robot.working_pose is not None
    pose = named_pose(robot.working_pose, robot, "working_pose")
    Orders(motion, robot.robot()).check(controller, pose, 60.0)


def test_path_from_the_homed_pose_to_the_working_pose_is_accepted(name: str):
    """After homing the rotations are at zero and the translations are retracted."""
    bench = load_station(None, {"robot": name}).bench()
    homed = np.array([0.0 if joint.motion == "rotation" else joint.lower for joint in bench.robot.joints])
    start = goto_working_pose(bench)
    assert start.load is None  # the load at the tip does not change
    assert not start.recorded
    check_path(bench, start, homed)


def test_station_starts_at_the_working_pose_of_its_robot(name: str):
    bench = load_station(None, {"robot": name}).bench()
    assert bench.robot.working_pose is not None
    assert bench.park == tuple(bench.robot.working_pose[joint.name] for joint in bench.robot.joints)


def test_goto_outside_the_travel_is_refused_with_joint_value_and_bound():
    bench = load_station(None).bench()
    with pytest.raises(CtrError, match=r"inner_translation 0.1 m is outside -0.13 ... -0.005 m"):
        goto_joints(bench, np.array([0.0, 0.0, 0.1]), "away")


def test_goto_is_refused_if_the_tubes_would_snap_on_the_path(write, robot_text):
    """Tubes with twice the curvature snap when one turns by more than half a turn relative to the other."""
    robot = robot_text.replace("[4.0, 0.0]", "[8.0, 0.0]")
    bench = load_station(None, {"robot": str(write(robot, "robot"))}).bench()
    together = np.array([0.0, 0.0, -0.1])
    with pytest.raises(CtrError, match=r"to the other side: after 6\d % of the path the tubes would snap"):
        check_path(bench, goto_joints(bench, np.array([0.0, 5.0, -0.1]), "to the other side"), together)
    check_path(bench, goto_joints(bench, np.array([0.0, 3.0, -0.1]), "to the other side"), together)


def test_error_for_a_robot_without_a_working_pose_names_the_key_to_add(write, robot_text):
    lines = "\n".join(line for line in robot_text.splitlines() if not line.startswith("working_pose"))
    path = str(write(lines, "robot"))
    park = {"outer_rotation": 0.0, "inner_rotation": 1.0, "inner_translation": -0.1}
    with pytest.raises(CtrError, match="robot 'paper' has no working_pose: add one to its file"):
        goto_working_pose(load_station(None, {"robot": path, "park": park}).bench())
    with pytest.raises(CtrError, match=r"park is missing: robot 'paper' has no working_pose to start from; add park"):
        load_station(None, {"robot": path}).bench()


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("{ outer_rotation = 0.0 }", "working_pose.inner_rotation, working_pose.inner_translation are missing"),
        ("{ outer_rotation = 0.0, inner_rotation = 0.0, inner_translation = 0.1 }", "inner_translation 0.1 m is out"),
    ],
)
def test_error_for_an_invalid_working_pose_names_the_file(write, robot_text, given, reason):
    start = robot_text.index("working_pose = ")
    end = robot_text.index("\n", start)
    path = write(robot_text[:start] + "working_pose = " + given + robot_text[end:], "robot")
    with pytest.raises(CtrError) as refused:
        load_robot(str(path))
    assert str(refused.value).startswith(f"{path}: ")
    assert reason in str(refused.value)


def test_error_names_the_joints_that_park_lacks(write):
    with pytest.raises(CtrError, match=r"park.inner_rotation, park.inner_translation are missing: park needs every"):
        load_station(write("park = { outer_rotation = 0.0 }\n")).bench()
