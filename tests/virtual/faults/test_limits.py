"""A motion beyond a limit of joints, tube order or workspace is refused before it starts, with value and bound.

During a motion the control loop brakes before a limit. As a third layer, each stage stops at its maximum position.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from core.errors import CtrError, PoseError
from core.model.statics import Statics
from core.robot.limits import Configuration
from station.config.motions import CircleMotion, HoldMotion, JointSweepMotion, Orders, StepMotion
from station.config.robots import WorkspaceBoxFile, load_robot, named_pose
from station.config.strict import ConfigError
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.service.feasibility import goto_joints
from station.service.station_file import load_station
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (CircleMotion(radius=0.08, period=60.0), r"circle.* (travel|speed) of \w+"),
        (StepMotion(offset=(0.0, 0.0, 0.2)), r"step.*"),
        (
            JointSweepMotion(joint="inner_translation", speed=0.01, distance=0.2),
            r"inner_translation 0.1 m is outside -0.13 ... -0.005 m \(its travel\)",
        ),
        (
            JointSweepMotion(joint="outer_rotation", speed=1.0, distance=0.2),
            r"speed 1 rad/s is outside \+-0.349066 rad/s",
        ),
    ],
)
def test_motion_beyond_travel_or_speed_is_refused_before_its_start(case, motion, said) -> None:
    orders = Orders(motion, case.robot.robot())
    with pytest.raises(CtrError) as refusal:
        orders.check(case.controller, case.start, 60.0)
    assert re.search(said, str(refusal.value)), str(refusal.value)


def test_error_for_tube_order_or_workspace_has_value_and_bound() -> None:
    robot = load_robot("three_tubes").model_copy(
        update={"ends_in_order": True, "workspace": WorkspaceBoxFile(lower=(-0.1, -0.1, 0.0), upper=(0.1, 0.1, 0.2))}
    )
    order, box = robot.limits().others
    middle = np.array([0.5 * (joint.lower + joint.upper) for joint in robot.joints])
    out = middle.copy()
    slides = [i for i, joint in enumerate(robot.joints) if joint.motion == "translation"]
    out[slides[0]], out[slides[1]] = robot.joints[slides[0]].upper, robot.joints[slides[1]].lower
    nothing = np.zeros((3, len(robot.joints)))

    with pytest.raises(
        PoseError, match=r"tube order is violated by [\d.]+ mm; required: end of tube 'middle' beyond that of tube"
    ):
        order.check(Configuration(out, nothing, np.zeros(3), np.zeros(3)))
    with pytest.raises(PoseError, match=r"tip x 0.15 m is outside -0.1 ... 0.1 m \(the workspace\)"):
        box.check(Configuration(middle, nothing, np.array([0.15, 0.0, 0.1]), np.zeros(3)))


def test_control_loop_brakes_an_axis_before_the_end_of_its_travel(virtual: VirtualStation) -> None:
    virtual.ready()
    # The check before the motion is omitted on purpose: this test is about the second layer, the control loop.
    sweep = JointSweepMotion(joint="inner_translation", speed=-0.02, distance=1.0)
    virtual.loop.start(MotionTask(virtual.case.controller, Orders(sweep, virtual.case.robot.robot()), 6.0))
    virtual.until(lambda: virtual.loop.phase is Phase.MOVING)
    least, fastest = math.inf, 0.0
    while virtual.state is State.RUNNING:
        before = virtual.places[2]
        virtual.tick()
        least, fastest = min(least, virtual.places[2]), max(fastest, (before - virtual.places[2]) / 0.002)
    virtual.seconds(0.4)

    assert fastest == pytest.approx(0.02, rel=0.02)
    assert -0.130 <= least <= -0.129
    assert virtual.places[2] >= -0.130


@pytest.mark.parametrize("motion", [HoldMotion(), JointSweepMotion(joint="outer_rotation", speed=0.1, distance=0.1)])
def test_motion_that_starts_outside_the_workspace_is_refused(case, motion) -> None:
    box = WorkspaceBoxFile(lower=(-0.5, -0.5, 0.0), upper=(0.5, 0.5, 0.01))
    controller = replace(case.controller, limits=case.robot.model_copy(update={"workspace": box}).limits())
    with pytest.raises(PoseError, match=r"tip z [\d.]+ m is outside 0 ... 0.01 m \(the workspace\)"):
        Orders(motion, case.robot.robot()).check(controller, case.start, 1.0)


def test_error_for_a_working_pose_or_park_outside_the_workspace_names_the_file(tmp_path) -> None:
    from importlib.resources import files

    text = (files("station.config") / "presets/robots/paper.toml").read_text(encoding="utf-8")
    own = tmp_path / "own.toml"
    own.write_text(f"{text}\n[workspace]\nlower = [-0.5, -0.5, 0.0]\nupper = [0.5, 0.5, 0.01]\n")
    with pytest.raises(ConfigError, match=r"own.toml: tip z .* is outside 0 ... 0.01 m \(the workspace\)"):
        load_robot(str(own))

    own.write_text(f"{text}\n[workspace]\nlower = [-0.5, -0.5, 0.0]\nupper = [0.5, 0.5, 0.5]\n")
    bent = "{ outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.005 }"
    inside = load_robot(str(own))
    pose = np.array([0.0, math.pi / 2, -0.005])
    working = named_pose(inside.working_pose, inside, "working_pose")
    tip, at_work = (Statics(inside.robot()).solve(joints, np.zeros(6)).tip for joints in (pose, working))
    assert tip[2] > at_work[2]
    between = 0.5 * (tip[2] + at_work[2])
    own.write_text(f"{text}\n[workspace]\nlower = [-0.5, -0.5, 0.0]\nupper = [0.5, 0.5, {between}]\n")
    station = tmp_path / "station.toml"
    station.write_text(f'robot = "{own}"\npark = {bent}\n')
    with pytest.raises(ConfigError, match=r"station.toml: tip z .* \(the workspace\)"):
        load_station(station).bench()
    with pytest.raises(PoseError, match=r"tip z .* \(the workspace\)"):
        goto_joints(replace(load_station(None).bench(), robot=load_robot(str(own))), pose, "there")
