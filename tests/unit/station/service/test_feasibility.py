"""Checks before anything moves: cases, poses, motions of the tip, and suggestions in place of refused motions."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from core.control.reachability import check_pose
from core.errors import CtrError, Unreachable
from core.model.solution import pure_force
from core.model.statics import Statics
from station.config.controllers import DEFAULT_CONTROLLER
from station.config.motions import (
    CircleMotion,
    ForceMotion,
    HelixMotion,
    Orders,
    SinusoidMotion,
    StepMotion,
    TipMotion,
    WaypointsMotion,
)
from station.config.regions import MeshRegion, read_regions
from station.config.robots import load_robot, named_pose
from station.config.strict import preset_names
from station.control.commands import RequestError
from station.experiments.experiment import load_experiment
from station.service.commands import Start, experiment_start
from station.service.feasibility import (
    check_path,
    deviations_from_case,
    displaced_joints,
    excessive_force,
    goto_joints,
    goto_working_pose,
    incompatibility,
    suggest_motion,
)
from station.service.station_file import Rig, load_station
from station.service.supervisor import Supervisor
from tests.harness.cases import a_case
from tests.harness.own_devices import OWN_DEVICES


@cache
def bench_of(robot: str) -> Rig:
    """Return the virtual bench of a preset robot, whose check for snapping takes seconds."""
    return load_station(None, {"robot": robot}).bench()


@pytest.fixture(scope="module")
def bench():
    return load_station(None).bench()


def test_case_for_another_robot_is_refused_with_both_names():
    three = bench_of("three_tubes")
    assert "for robot 'paper'; this station has 'three_tubes'" in incompatibility(a_case("fig8", "regulation"), three)


def test_case_is_refused_if_a_robot_of_the_same_name_differs(bench):
    other = load_robot("paper").model_copy(update={"max_force": 1.0})
    case = a_case("fig8", "regulation")._replace(robot=other)
    assert "this station's robot of this name differs" in incompatibility(case, bench)


def test_case_is_refused_if_the_mesh_of_its_region_was_replaced_since_the_start(bench, tmp_path):
    file = tmp_path / "ball.stl"
    region = MeshRegion(name="ball", file=str(file), position=(0.0, 0.0, 0.5))
    trimesh.creation.icosphere(subdivisions=1, radius=10.0).export(file)
    known = replace(bench, keep_out=read_regions([region]))
    case = a_case("fig8", "regulation")

    def with_present_mesh():
        return case._replace(file=case.file.model_copy(update={"keep_out": read_regions([region])}))

    assert incompatibility(with_present_mesh(), known) == ""
    assert "does not know its region 'ball'" in incompatibility(with_present_mesh(), bench)
    trimesh.creation.icosphere(subdivisions=1, radius=9.0).export(file)
    assert "'ball' has changed since the start of the station" in incompatibility(with_present_mesh(), known)


def test_desired_force_is_refused_if_its_contact_would_end_in_hold(bench):
    """The force at a contact exceeds the desired one by up to a half, and a motion ends in HOLD at 0.94 N."""
    assert excessive_force(None, bench) == ""
    assert excessive_force(ForceMotion(direction=(0.0, 0.0, 1.0), force=0.62).press, bench) == ""
    text = excessive_force(ForceMotion(direction=(0.0, 0.0, 1.0), force=0.63).press, bench)
    assert "0.63 N is above 0.624 N" in text
    assert "HOLD at 0.936 N" in text


def test_case_with_an_excessive_desired_force_is_refused(bench):
    trajectory = {"kind": "force", "direction": [1.0, 0.0, 0.0]}
    for force, reason in ((0.62, ""), (0.7, "0.7 N is above 0.624 N")):
        case = load_experiment("touch", {"trajectory": {**trajectory, "force": force}}, only="wall").cases[0]
        refused = incompatibility(case, bench)
        assert (reason in refused) if reason else refused == ""


def test_free_motion_with_an_excessive_desired_force_is_refused_before_the_state_is_checked(bench):
    supervisor = Supervisor(bench)
    try:
        with pytest.raises(RequestError, match=r"0\.7 N is above 0\.624 N"):
            supervisor.send(Start(trajectory=ForceMotion(direction=(1.0, 0.0, 0.0), force=0.7)))
    finally:
        supervisor.close()


def test_warning_names_both_labs_if_the_lab_differs(bench):
    (text,) = deviations_from_case(a_case("fig8", "regulation_distorted"), bench)
    assert text.startswith("written for lab 'distorted', runs on this station instead: virtual lab: ")
    assert "serve --lab distorted" in text
    assert incompatibility(a_case("fig8", "regulation_distorted"), bench) == ""


def test_case_without_a_lab_is_compatible_with_every_lab(bench):
    realistic = load_station(None, {"lab": "realistic"}).bench()
    for one in (bench, realistic):
        assert deviations_from_case(a_case("fig8", "regulation"), one) == ()


def test_case_for_the_lab_of_the_station_is_compatible(bench):
    distorted = load_station(None, {"lab": "distorted"}).bench()
    assert deviations_from_case(a_case("fig8", "regulation_distorted"), distorted) == ()


def test_warning_names_the_bench_if_the_devices_are_real(write):
    own = load_station(write(OWN_DEVICES)).bench()
    (text,) = deviations_from_case(a_case("fig3", "a"), own)
    assert "written for lab 'ideal', runs on this station instead: bench of 'paper'" in text


def test_case_that_follows_a_target_requires_a_target_coil(bench, write):
    follows = a_case("follow", "breathing")
    assert "no second coil for a target: `serve --lab breathing`" in incompatibility(follows, bench)
    assert "name its coil in devices.tracker.target" in incompatibility(
        follows, load_station(write(OWN_DEVICES)).bench()
    )
    assert incompatibility(follows, load_station(None, {"lab": "heartbeat"}).bench()) == ""


def test_case_with_faults_requires_the_virtual_lab(write, short):
    text = short + '[[faults]]\nkind = "mute"\ndevice = "tracker"\nat = 0.5\n'
    (case,) = load_experiment(str(write(text, "muted"))).cases
    assert "its faults need simulated devices" in incompatibility(case, load_station(write(OWN_DEVICES)).bench())


def test_warning_names_both_calibrations_if_the_calibration_differs(bench):
    case = a_case("fig8", "regulation", calibration="found/monday")
    (text,) = deviations_from_case(case, bench)
    begin = f"written with the calibration {Path('found/monday')}, runs with this station's (none)"
    assert text.startswith(begin)


def test_recording_has_the_present_lab_and_the_deviations_from_the_case(bench):
    supervisor = Supervisor(bench)
    try:
        start = experiment_start(supervisor, "fig8", "regulation_distorted")
        plain = experiment_start(supervisor, "fig8", "regulation")
    finally:
        supervisor.close()
    (text,) = start.about["otherwise"]
    assert start.warnings[0] == text
    assert start.about["settings"]["lab"] == "gentle"
    assert plain.about["otherwise"] == []


#: Motions that the page and the README propose.
MOTIONS = [
    CircleMotion(radius=0.01, period=20.0),
    HelixMotion(radius=0.008, pitch=0.003, turn=20.0, turns=3.0),
    SinusoidMotion(amplitude=0.01, frequency=0.05),
    SinusoidMotion(amplitude=0.01, frequency=0.05, direction=(1.0, 0.0, 0.0)),
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


@pytest.mark.parametrize("name", ["paper", "three_tubes", "nylon"])
def test_path_from_the_homed_pose_to_the_working_pose_is_accepted(name: str):
    """After homing the rotations are at zero and the translations are retracted."""
    bench = bench_of(name)
    homed = np.array([0.0 if joint.motion == "rotation" else joint.lower for joint in bench.robot.joints])
    start = goto_working_pose(bench)
    assert start.load is None  # the load at the tip does not change
    assert not start.recorded
    check_path(bench, start, homed)


@pytest.mark.parametrize("name", ["paper", "three_tubes", "nylon"])
def test_station_starts_at_the_working_pose_of_its_robot(name: str):
    bench = bench_of(name)
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
    with pytest.raises(CtrError, match=r"to the other side: after 6\d % of the path tubes that differ by 5 %"):
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


ROBOT = load_robot("paper")
CONTROLLER = DEFAULT_CONTROLLER.controller(ROBOT)
POSE = np.array([0.0, np.pi / 2, -0.1])
TOO_QUICK = [
    (CircleMotion(radius=0.01, period=4.0), r"a period of (\S+) s", "period"),
    (SinusoidMotion(amplitude=0.02, frequency=0.4), r"a frequency of (\S+) Hz", "frequency"),
    (HelixMotion(radius=0.01, pitch=0.003, turn=4.0, turns=3.0), r"(\S+) s for one turn", "turn"),
]


@pytest.mark.parametrize(("motion", "text", "key"), TOO_QUICK)
def test_suggested_motion_passes_the_check_of_its_path(motion: TipMotion, text: str, key: str):
    with pytest.raises(Unreachable):
        Orders(motion, ROBOT.robot()).check(CONTROLLER, POSE, 60.0)
    found = re.fullmatch(text + " would work from here", suggest_motion(motion, CONTROLLER, POSE, 60.0))
    assert found is not None
    Orders(motion.model_copy(update={key: float(found[1])}), ROBOT.robot()).check(CONTROLLER, POSE, 60.0)


def test_smaller_motion_is_suggested_if_a_slower_one_does_not_work():
    circle = CircleMotion(radius=0.05, period=20.0)
    assert suggest_motion(circle, CONTROLLER, POSE, 60.0) == "a radius of 10 mm would work from here"
    step = StepMotion(offset=(0.09, 0.0, 0.0))
    assert suggest_motion(step, CONTROLLER, POSE, 60.0) == "an offset of 18 mm, 0 mm, 0 mm would work from here"


def test_longer_times_are_suggested_for_waypoints():
    points = WaypointsMotion(points=((1.0, 0.0, 0.01, 0.0), (2.0, 0.0, 0.0, 0.0)), max_speed=0.1)
    assert suggest_motion(points, CONTROLLER, POSE, 2.0) == "waypoint times multiplied by 2 would work from here"


def test_suggestion_is_empty_if_no_slower_or_smaller_motion_works():
    homed = np.array([0.0, 0.0, -0.13])  # the tubes are straight, and the translation is at the end of its travel
    assert suggest_motion(CircleMotion(radius=0.01, period=20.0), CONTROLLER, homed, 60.0) == ""


def test_suggested_value_is_inside_its_valid_range():
    """A period beyond the longest valid one is not suggested."""
    slow = CircleMotion(radius=0.1, period=3600.0)
    assert "period" not in suggest_motion(slow, CONTROLLER, POSE, 60.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("step", [1e-4, -1e-3, 5e-3])
def test_step_of_the_tip_displaces_the_loaded_models_tip_by_its_size(bench, axis, step):
    joints, force, offset = np.array([0.1, 1.5, -0.09]), np.array([0.1, -0.05, 0.0]), step * np.eye(3)[axis]

    found = displaced_joints(bench, joints, force, offset)

    model = Statics(bench.robot.robot())
    moved = (model.solve(found, pure_force(force)).tip - model.solve(joints, pure_force(force)).tip).tolist()
    assert moved == pytest.approx(offset.tolist(), abs=2e-6)
    assert np.abs(found - joints).max() < 1.0  # near the present pose


def test_step_of_the_tip_beyond_its_reach_is_refused(bench):
    with pytest.raises(CtrError):
        check_pose(
            Statics(bench.robot.robot()), bench.limits,
            displaced_joints(bench, np.array([0.0, 1.5, -0.006]), np.zeros(3), np.array([0.0, 0.0, 0.02])),
        )  # fmt: skip
