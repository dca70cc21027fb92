"""What joints do that a task leaves over: away from edges, without touching the task."""

import numpy as np
import pytest

from core.control.inverse import inverse
from core.control.pointing import aim, rows_of
from core.control.spare import MOST, STABLE, Slope, Spare
from core.errors import DescriptionError
from core.model.statics import Statics
from station.config.robots import load_robot, start_pose

FILE = load_robot("balanced_pair")
LIMITS = FILE.limits()
POSE = start_pose(FILE.working_pose, FILE)
#: The pair nearly opposed: a margin of 0.3.
NEAR_THE_EDGE = np.array([1.587, -0.4, 2.993, -0.028, -0.075, -0.164])


@pytest.fixture(scope="module")
def solved():
    model = Statics(FILE.robot())
    return model, model.solve(POSE, np.r_[0.1, 0.1, 0.0, np.zeros(3)])


def test_the_slope_is_that_of_the_margin_once_every_joint_has_been_tried(solved):
    model, _ = solved
    now, slope = model.solve(NEAR_THE_EDGE, np.r_[0.1, 0.1, 0.0, np.zeros(3)]), None
    assert now.stability < STABLE
    for _ in range(6 * 30):
        slope = Spare({"stability": 1.0}).tried(model, LIMITS, now, slope)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-3 * LIMITS.speed[k]
        ends = [model.solve(NEAR_THE_EDGE + side * step, now.wrench).stability for side in (1.0, -1.0)]
        assert slope.values[k] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=0.1, abs=2e-3)  # one side


def test_nothing_is_tried_that_nobody_asked_for(solved):
    model, now = solved
    assert not Spare({"limits": 1.0}).tried(model, LIMITS, now, None).values.any()


def test_nothing_is_tried_far_from_the_edge(solved):
    model, now = solved
    assert now.stability > STABLE
    slope = Slope(np.ones(6), 2)
    assert Spare({"stability": 1.0}).tried(model, LIMITS, now, slope) is slope
    assert not Spare({"stability": 1.0}).velocity(LIMITS, POSE, now.stability, slope).any()


def test_limits_push_inward_and_the_order_apart_and_never_faster_than_allowed():
    still, joints = Slope(np.zeros(6), 0), POSE.copy()
    joints[5] = -0.1205
    away = Spare({"limits": 1.0}).velocity(LIMITS, joints, 1.0, still)
    assert away[5] < 0.0
    assert np.abs(away / LIMITS.speed).max() == pytest.approx(MOST)
    joints = POSE.copy()
    joints[3], joints[4] = -0.026, -0.0955  # the middle tube is nearly flush with the outer one
    apart = Spare({"order": 1.0}).velocity(LIMITS, joints, 1.0, still)
    assert apart[4] - apart[3] > 0.0
    assert not apart[:3].any()


@pytest.mark.parametrize("task", ["position", "position_and_direction"])
def test_the_task_is_kept_whatever_the_left_over_joints_do(solved, task):
    _, now = solved
    rows, rng = rows_of(aim(task), now.jacobian, now.rotation), np.random.default_rng(3)
    wanted, wish = 1e-3 * rng.normal(size=len(rows)), 0.2 * LIMITS.speed * rng.normal(size=6)
    lower, upper = LIMITS.velocity_bounds(POSE)
    still, busy = (inverse(rows, wanted, LIMITS.speed, lower, upper, spare=spare).velocity for spare in (None, wish))
    for velocity in (still, busy):
        np.testing.assert_allclose(rows @ velocity, wanted, rtol=0, atol=1e-8)
    # What differs is the wish's part in the null space, joints measured by their top speed.
    scaled = rows * LIMITS.speed
    inside = np.eye(6) - np.linalg.pinv(scaled) @ scaled
    np.testing.assert_allclose((busy - still) / LIMITS.speed, inside @ (wish / LIMITS.speed), rtol=0, atol=1e-4)


def test_what_is_no_edge_is_refused_by_name():
    with pytest.raises(DescriptionError, match="'comfort' is unknown; choose of stability, limits, order"):
        Spare({"comfort": 1.0})
    with pytest.raises(DescriptionError, match="weight -1 of 'limits'"):
        Spare({"limits": -1.0})
