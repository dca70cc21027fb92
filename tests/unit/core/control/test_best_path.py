"""The best path against what can be worked out by hand, and against other paths."""

import math

import numpy as np
import pytest

from core.control.best_path import Course, best_path
from core.errors import DescriptionError
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits
from core.robot.robot import Section

SPEED, ACCELERATION = 0.020, 0.100
#: One straight tube of 0.2 m that turns and slides: its tip goes along z with the translation.
LIMITS = Limits(
    (
        JointLimit("rotation", "rad", -6.0, 6.0, 0.35, 1.75),
        JointLimit("translation", "m", -0.1, -0.01, SPEED, ACCELERATION),
    )
)
START = np.array([0.0, -0.05])
STILL = np.zeros(2)
STIFFNESS = 0.04


@pytest.fixture(scope="module")
def rod(one_tube):
    return Statics(one_tube(Section(0.2), bending_stiffness=STIFFNESS), 0.005)


def along_z(rod: Statics, times: np.ndarray, heights: np.ndarray) -> Course:
    """Targets that leave the start tip along z, without load."""
    tip = rod.solve(START, np.zeros(6)).tip
    return Course(times, tip + np.outer(heights, (0.0, 0.0, 1.0)), np.zeros((len(times), 3)))


def test_a_target_faster_than_the_joint_is_missed_by_what_top_speed_and_acceleration_leave(rod):
    times = np.linspace(0.0, 1.0, 101)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, 0.030 * times))

    # speed T - speed^2 / (2 a) is the farthest that a joint gets from rest
    reached = SPEED * 1.0 - SPEED**2 / (2.0 * ACCELERATION)
    assert best.largest == pytest.approx(0.030 - reached, rel=2e-3)


def test_a_jump_that_is_known_before_is_missed_by_half_of_it_on_either_side(rod):
    """With time enough the joint is halfway when the target jumps by 8 mm."""
    times = np.linspace(0.0, 2.0, 101)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, np.where(times < 1.0 - 1e-9, 0.0, 0.008)))

    # between the last moment before the jump and the first after it the joint goes on at top speed
    assert best.largest == pytest.approx(0.5 * (0.008 - SPEED * 0.02), rel=5e-3)


def test_a_target_within_reach_is_met(rod):
    times = np.linspace(0.0, 10.0, 101)
    height = 0.010 * np.sin(2.0 * np.pi * times / 20.0) ** 2
    assert best_path(rod, LIMITS, START, STILL, along_z(rod, times, height)).largest < 2e-5


def test_a_target_beyond_the_travel_is_missed_by_what_the_travel_leaves(rod):
    times = np.linspace(0.0, 8.0, 81)
    best = best_path(rod, LIMITS, START, STILL, along_z(rod, times, np.minimum(0.006 * times, 0.045)))

    assert best.largest == pytest.approx(0.045 - 0.040, rel=2e-3)
    assert best.joints[:, 1].max() <= -0.01 + 1e-9


def test_a_step_of_load_deflects_a_cantilever_before_any_joint_can_move(rod):
    """F L^3 / (3 EI) at the first instant, whatever comes after."""
    times, force, length = np.linspace(0.0, 1.0, 51), 0.05, 0.15
    tip = rod.solve(START, np.zeros(6)).tip
    course = Course(times, np.tile(tip, (51, 1)), np.tile((force, 0.0, 0.0), (51, 1)))
    best = best_path(rod, LIMITS, START, STILL, course)

    assert best.largest == pytest.approx(force * length**3 / (3.0 * STIFFNESS), rel=2e-3)
    assert best.largest == pytest.approx(np.linalg.norm(best.errors[0]), rel=1e-6)


# ---- the paper's robot

POSE = np.array([0.0, math.pi / 2, -0.1])
TOP = math.radians(20.0)
PAPER = Limits(
    (
        JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, TOP, 5 * TOP),
        JointLimit("inner_rotation", "rad", -2 * math.pi, 2 * math.pi, TOP, 5 * TOP),
        JointLimit("inner_translation", "m", -0.130, -0.005, 0.020, 0.100),
    )
)


@pytest.fixture(scope="module")
def model(paper_robot):
    return Statics(paper_robot)


def ramp(model: Statics, rise: float, until: float, moments: int = 101) -> Course:
    """Half a newton along x within `rise` [s], the tip to stay."""
    times = np.linspace(0.0, until, moments)
    pull = 0.5 * np.clip(times / rise, 0.0, 1.0) if rise > 0.0 else np.full(moments, 0.5)
    tip = model.solve(POSE, np.zeros(6)).tip
    return Course(times, np.tile(tip, (moments, 1)), np.outer(pull, (1.0, 0.0, 0.0)))


def deflection(model: Statics) -> float:
    """What half a newton does when no joint moves [m]."""
    loaded, rest = (model.solve(POSE, np.array([pull, 0.0, 0.0, 0.0, 0.0, 0.0])).tip for pull in (0.5, 0.0))
    return float(np.linalg.norm(loaded - rest))


def test_the_slower_the_load_the_less_is_left(model):
    slow, medium, fast, step = (
        best_path(model, PAPER, POSE, np.zeros(3), ramp(model, rise, max(2.0 * rise, 1.0))).largest
        for rise in (20.0, 1.5, 0.5, 0.0)
    )

    assert slow < 1e-4 < medium < fast < step
    assert step == pytest.approx(deflection(model), rel=1e-6)


def test_the_path_keeps_speed_acceleration_and_travel_and_its_errors_are_those_of_the_model(model):
    course = ramp(model, 0.7, 2.0)
    best = best_path(model, PAPER, POSE, np.zeros(3), course)
    dt = np.diff(course.times)
    velocity = np.diff(best.joints, axis=0) / dt[:, None]
    acceleration = np.diff(velocity, axis=0) / dt[1:, None]
    _, _, speed, most, _ = PAPER.packed

    assert best.joints[0] == pytest.approx(POSE)
    assert (np.abs(velocity) <= speed * (1.0 + 1e-6)).all()
    assert (np.abs(acceleration) <= most * (1.0 + 1e-4)).all()
    for k in (0, 20, 35, 60, 100):
        tip = model.solve(best.joints[k], np.r_[course.forces[k], np.zeros(3)]).tip
        assert course.targets[k] - tip == pytest.approx(best.errors[k], abs=1e-7)


def test_no_path_found_at_random_next_to_it_is_better(model):
    """Other joint paths within the same speeds leave a larger error: what has been found is a minimum."""
    course = ramp(model, 0.7, 1.4, 71)
    best = best_path(model, PAPER, POSE, np.zeros(3), course)
    _, _, speed, most, _ = PAPER.packed
    rng, dt = np.random.default_rng(3), course.times[1]
    rates = np.diff(best.joints, axis=0) / dt
    for _ in range(30):
        # A bump over a tenth to a half of the time in all joints; kept where it breaks no limit.
        middle, width = rng.uniform(0.0, 1.0), rng.uniform(0.1, 0.5)
        bump = np.exp(-(((course.times[1:] / 1.4 - middle) / width) ** 2))
        moved = np.clip(rates + 0.2 * np.outer(bump, speed * rng.normal(size=3)), -speed, speed)
        limited, before = [], np.zeros(3)
        for k, each in enumerate(moved):
            step = most * dt * (0.5 if k == 0 else 1.0)
            before = np.clip(each, before - step, before + step)
            limited.append(before)
        joints = np.vstack((POSE, POSE + dt * np.cumsum(limited, axis=0)))
        tips = [model.solve(q, np.r_[f, 0.0, 0.0, 0.0]).tip for q, f in zip(joints, course.forces, strict=True)]
        assert np.linalg.norm(course.targets - tips, axis=1).max() >= best.largest * (1.0 - 5e-3)


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [1.0, 0.5]])
def test_moments_that_are_no_course_are_refused(model, times):
    with pytest.raises(DescriptionError, match="a course needs two moments"):
        best_path(model, PAPER, POSE, np.zeros(3), Course(np.array(times), np.zeros((3, 3)), np.zeros((3, 3))))
