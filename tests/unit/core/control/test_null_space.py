"""Null-space objective: redundant joints move away from their bounds without changing the task."""

from dataclasses import replace

import numpy as np
import pytest

from core.control.null_space import (
    KINK_DISTANCE_M,
    MAX_SPEED_SHARE,
    STABILITY_SCALE,
    NullSpaceObjective,
    StabilityGradient,
    kinks_of,
)
from core.control.tip_direction import task_rows, task_selection
from core.control.velocity_ik import inverse
from core.errors import DescriptionError
from core.model.statics import Statics
from station.config.robots import load_robot, start_pose

FILE = load_robot("balanced_pair")
LIMITS = FILE.limits()
POSE = start_pose(FILE.working_pose, FILE)
#: Joints at which the two tubes of the pair are nearly opposed; the stability margin is 0.3.
NEAR_THE_EDGE = np.array([1.587, -0.4, 2.993, -0.028, -0.075, -0.164])


WRENCH = np.r_[0.1, 0.1, 0.0, np.zeros(3)]
KINKS = kinks_of(FILE.robot())
STILL = StabilityGradient(np.zeros(6), 0)


def at_kink(positive: str, negative: str, distance: float) -> np.ndarray:
    """Return joints at a given distance from the kink of two translations; the first translation is moved [m]."""
    names, joints = [joint.name for joint in LIMITS.joints], POSE.copy()
    row = np.zeros(6)
    row[names.index(positive)], row[names.index(negative)] = 1.0, -1.0
    (k,) = np.flatnonzero((KINKS.rows == row).all(axis=1))
    joints[names.index(positive)] += distance - (row @ joints + KINKS.offsets[k])
    return joints


@pytest.fixture(scope="module")
def solved():
    model = Statics(FILE.robot())
    return model, model.solve(POSE, np.r_[0.1, 0.1, 0.0, np.zeros(3)])


def test_stability_gradient_is_correct_after_a_trial_solve_of_every_joint(solved):
    model, _ = solved
    now, slope = model.solve(NEAR_THE_EDGE, np.r_[0.1, 0.1, 0.0, np.zeros(3)]), None
    assert now.stability < STABILITY_SCALE
    for _ in range(6 * 30):
        slope = NullSpaceObjective({"stability": 1.0}).updated_gradient(model, LIMITS, now, slope)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-3 * LIMITS.speed[k]
        ends = [model.solve(NEAR_THE_EDGE + side * step, now.wrench).stability for side in (1.0, -1.0)]
        # the gradient is a one-sided difference, so it differs from this central one
        assert slope.values[k] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=0.1, abs=2e-3)


def test_null_space_objective_without_a_stability_weight_or_far_from_the_edge_makes_no_trial_solve(solved):
    model, now = solved
    assert not NullSpaceObjective({"limits": 1.0}).updated_gradient(model, LIMITS, now, None).values.any()
    assert now.stability > STABILITY_SCALE
    slope = StabilityGradient(np.ones(6), 2)
    assert NullSpaceObjective({"stability": 1.0}).updated_gradient(model, LIMITS, now, slope) is slope
    assert not NullSpaceObjective({"stability": 1.0}).velocity(LIMITS, POSE, now.stability, slope).any()


def test_ends_of_travel_and_tube_order_repel_the_joints_at_bounded_speed():
    still, joints = StabilityGradient(np.zeros(6), 0), POSE.copy()
    joints[5] = -0.1205
    away = NullSpaceObjective({"limits": 1.0}).velocity(LIMITS, joints, 1.0, still)
    assert away[5] < 0.0
    assert np.abs(away / LIMITS.speed).max() == pytest.approx(MAX_SPEED_SHARE)
    joints = POSE.copy()
    joints[3], joints[4] = -0.026, -0.0955  # the middle tube is nearly flush with the outer one
    apart = NullSpaceObjective({"order": 1.0}).velocity(LIMITS, joints, 1.0, still)
    assert apart[4] - apart[3] > 0.0
    assert not apart[:3].any()


@pytest.mark.parametrize("task", ["position", "position_and_direction"])
def test_null_space_motion_does_not_change_the_task(solved, task):
    _, now = solved
    rows, rng = task_rows(task_selection(task), now.jacobian, now.rotation), np.random.default_rng(3)
    desired, preferred_velocity = 1e-3 * rng.normal(size=len(rows)), 0.2 * LIMITS.speed * rng.normal(size=6)
    lower, upper = LIMITS.velocity_bounds(POSE)
    still, busy = (
        inverse(rows, desired, LIMITS.speed, lower, upper, preferred=spare).velocity
        for spare in (None, preferred_velocity)
    )
    for velocity in (still, busy):
        np.testing.assert_allclose(rows @ velocity, desired, rtol=0, atol=1e-8)
    # The two velocities differ by the preferred velocity's null-space part; each joint is scaled by its top speed.
    scaled = rows * LIMITS.speed
    inside = np.eye(6) - np.linalg.pinv(scaled) @ scaled
    np.testing.assert_allclose(
        (busy - still) / LIMITS.speed, inside @ (preferred_velocity / LIMITS.speed), rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("outer", ["middle_translation", "outer_translation"])
def test_the_jacobian_jumps_only_for_motions_across_a_kink(solved, outer):
    model, _ = solved
    before, after, further = (
        model.solve(at_kink("inner_translation", outer, side), WRENCH).jacobian[:3] * LIMITS.speed
        for side in (-1e-5, 1e-5, 3e-5)
    )
    slides = [LIMITS.joints[k].name in ("inner_translation", outer) for k in range(6)]
    jump = after - before
    assert np.abs(jump[:, slides]).max() > 5e-3  # [m/s]
    # when both tubes move together, the robot stays on the same side of the kink
    assert np.abs(jump[:, slides].sum(axis=1)).max() < 1e-4
    assert np.abs(jump[:, np.logical_not(slides)]).max() < 1e-4
    assert np.abs(further - after).max() < 1e-4


def test_joint_velocity_from_one_side_of_a_kink_is_valid_on_the_other_side(solved):
    model, _ = solved
    sides = []
    for side in (-1e-5, 1e-5):
        joints = at_kink("inner_translation", "middle_translation", side)
        now = model.solve(joints, WRENCH)
        rows = task_rows(task_selection("position"), now.jacobian, now.rotation)
        desired = np.array([-2e-3, 1e-3, 1e-3])
        objective = NullSpaceObjective({"order": 1.0}).objective(LIMITS, KINKS, joints, now.stability, STILL)
        limits = (LIMITS.speed, *LIMITS.velocity_bounds(joints))
        plain, resisting = (
            inverse(rows, desired, *limits, preferred=objective.velocity, resisted=resisted).velocity
            for resisted in (None, objective.resisted)
        )
        np.testing.assert_allclose(rows @ resisting, desired, rtol=0, atol=1e-7)
        sides.append((rows, desired, plain, resisting))
    (rows, desired, _, _), (_, _, plain, resisting) = sides
    assert np.abs(rows @ resisting - desired).max() < 0.1 * np.abs(rows @ plain - desired).max()


def test_distant_kink_resists_no_motion_and_tubes_of_one_section_have_no_kinks():
    joints = at_kink("inner_translation", "middle_translation", -1.01 * KINK_DISTANCE_M)
    assert not NullSpaceObjective({}).objective(LIMITS, KINKS, joints, 1.0, STILL).resisted[0].any()
    robot = FILE.robot()
    bent = tuple(replace(tube, sections=tube.sections[-1:]) for tube in robot.tubes)
    assert kinks_of(replace(robot, tubes=bent)).rows.shape == (0, 6)


def test_unknown_edge_of_the_null_space_objective_is_refused_by_name():
    with pytest.raises(DescriptionError, match="'comfort' is unknown; choose one of stability, limits, order"):
        NullSpaceObjective({"comfort": 1.0})
    with pytest.raises(DescriptionError, match="weight -1 of 'limits'"):
        NullSpaceObjective({"limits": -1.0})
