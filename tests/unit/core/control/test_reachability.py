"""Motions that the robot cannot follow are refused in advance, with the time and the limit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.control.reachability import check_reach
from core.control.tip_direction import task_selection
from core.control.trajectories import (
    CircleMotion,
    Directions,
    HelixMotion,
    HoldMotion,
    SinusoidMotion,
    StepMotion,
    Waypoints,
)
from core.errors import CtrError, Unreachable
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits, Workspace

POSE = np.array([0.0, math.pi / 2, -0.1])
SPEED = math.radians(20.0)
LIMITS = Limits(
    (
        JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
        JointLimit("inner_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
        JointLimit("inner_translation", "m", -0.130, -0.005, 0.020, 0.100),
    )
)


@pytest.fixture(scope="module")
def model(paper_robot):
    return Statics(paper_robot)


@pytest.mark.parametrize(
    "motion",
    [
        HoldMotion(),
        SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.015, frequency=0.05),
        CircleMotion(radius=0.010, period=12.0),
        HelixMotion(radius=0.005, pitch=0.003, turn=10.0, turns=2.0),
        StepMotion(offset=(1e-3, 0.0, 0.0)),
        StepMotion(offset=(1e-3, 0.0, 0.0), stay=4.0),
        Waypoints((5.0, 10.0), ((0.01, 0.0, 0.0), (0.0, 0.0, 0.0))),
    ],
    ids=repr,
)
def test_motions_within_reach_pass_the_reachability_check(model, motion):
    check_reach(model, LIMITS, POSE, motion, 60.0)


def refusal(model, motion, duration=60.0, limits=LIMITS, joints=POSE, force=None) -> str:
    with pytest.raises(Unreachable) as refused:
        check_reach(model, limits, joints, motion, duration, force)
    return str(refused.value)


def test_motion_that_is_too_fast_is_refused_with_the_first_time_and_the_joint(model):
    """A motion of 15 mm in 12 s needs a rotation faster than 20 deg/s; the same motion in 40 s does not."""
    text = refusal(model, CircleMotion(radius=0.015, period=12.0))

    assert "cannot be followed: at 7.8" in text
    assert "mm off (more than 0.5 mm) because of speed of" in text
    check_reach(model, LIMITS, POSE, CircleMotion(radius=0.015, period=40.0), 60.0)


def test_path_out_of_reach_is_refused_at_any_speed_with_the_singular_pose(model):
    assert "singular pose (sigma" in refusal(
        model, CircleMotion(radius=0.015, period=400.0, normal=(0.0, 0.0, -1.0)), 400.0
    )


def test_motion_beyond_a_joints_travel_is_refused_with_the_travel_and_the_time(model):
    text = refusal(model, SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.050, frequency=0.01), 100.0)

    # The tip's z follows the translation, which can still move 30 mm inward and 95 mm outward.
    assert "travel of inner_translation (-0.13 m)" in text
    time = float(text.split(" at ")[1].split(" s ")[0])
    assert 50.0 < time < 75.0  # the time of the downward half wave


def test_reachability_check_ignores_the_path_after_the_end_of_the_motion(model):
    check_reach(model, LIMITS, POSE, SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.050, frequency=0.01), 40.0)


def test_motion_out_of_the_workspace_is_refused_with_the_workspace_bound(model):
    tip = model.solve(POSE, np.zeros(6)).tip
    box = Workspace((-1.0, -1.0, 0.0), (1.0, 1.0, float(tip[2]) + 5e-3))

    assert "workspace z <=" in refusal(
        model,
        SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.010, frequency=0.05),
        limits=replace(LIMITS, others=(box,)),
    )


def test_load_that_the_joints_cannot_compensate_is_refused(model):
    """Both tubes already bend fully toward -y, so they cannot compensate for a load along +y."""
    straight = np.array([0.0, 0.0, -0.05])

    def pull(time: float) -> np.ndarray:
        return np.array([0.0, 0.05 * time, 0.0])

    text = refusal(model, HoldMotion(), 10.0, joints=straight, force=pull)
    assert "singular pose" in text
    assert 0.0 < float(text.split(" at ")[1].split(" s ")[0]) < 10.0


def test_load_that_starts_with_the_motion_is_checked_for_reachability(model):
    """A sudden load of half a newton moves the tip by about 15 mm; a load present before the start does not move it."""
    text = refusal(model, HoldMotion(), 10.0, force=lambda time: np.array([0.5 * (time >= 0.0), 0.0, 0.0]))

    assert "at 0 s the tip would be 1" in text
    check_reach(model, LIMITS, POSE, HoldMotion(), 10.0, lambda _: np.array([0.5, 0.0, 0.0]))


def test_step_trajectory_is_checked_at_its_end_and_not_at_its_jump(model):
    assert "at 0 s" in refusal(model, StepMotion(offset=(0.05, 0.0, 0.0)))


def test_motion_from_a_start_pose_outside_the_travel_is_refused(model):
    with pytest.raises(CtrError, match="inner_translation"):
        check_reach(model, LIMITS, np.array([0.0, 0.0, -0.2]), HoldMotion(), 1.0)


def test_reachability_check_of_a_long_periodic_motion_ends_after_one_period(model, monkeypatch):
    solves = []
    solve = Statics.solve
    monkeypatch.setattr(Statics, "solve", lambda *arguments: solves.append(1) or solve(*arguments))

    check_reach(
        model, LIMITS, POSE, SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.010, frequency=0.05), 86_400.0
    )

    assert len(solves) < 1100  # only one period of 20 s is checked


def turned(heading, degrees: float) -> Directions:
    """Return directions that turn from a heading (3,) about y by an angle in 10 s."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    there = (cos * heading[0] + sin * heading[2], heading[1], cos * heading[2] - sin * heading[0])
    return Directions(((0.0, *heading), (10.0, *there)))


def test_direction_within_reach_passes_the_check_and_one_out_of_reach_is_refused_in_degrees(model):
    """Tubes whose curves are side by side bend the tip by less than 60 deg."""
    heading = model.solve(POSE, np.zeros(6)).rotation[:, 2]
    aim = task_selection("direction")
    slightly, beyond = turned(heading, 8.0), turned(heading, 60.0)

    check_reach(model, LIMITS, POSE, HoldMotion(), 12.0, aim=aim, directions=slightly)
    with pytest.raises(Unreachable, match=r"at [2-9]\.\d+ s the tip would point \d\.?\d* deg off \(more than"):
        check_reach(model, LIMITS, POSE, HoldMotion(), 12.0, aim=aim, directions=beyond)
