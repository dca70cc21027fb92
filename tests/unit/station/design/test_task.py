"""Evaluation of a task: model and exact rod confirm that the robot can hold the found loads."""

import numpy as np
import pytest

from core.model.statics import Statics
from station.config.robots import load_robot
from station.design.outcome import exact
from station.design.study import load_study
from station.design.task import cost, evaluate

PAPER = load_robot("paper")
TASK = load_study("fig10_load").file.task


@pytest.fixture(scope="module")
def outcome():
    return evaluate(PAPER, TASK, "load")


def test_joints_that_hold_a_load_are_within_their_travel_and_bring_the_tip_to_the_points(outcome):
    model, limits = Statics(PAPER.robot()), PAPER.limits()
    for held in (outcome.nominal, outcome.largest):
        for force, row in zip(TASK.forces, held.joints, strict=True):
            for point, joints in zip(TASK.points, row, strict=True):
                limits.check(joints)
                found = model.solve(joints, np.concatenate((held.load * np.array(force), np.zeros(3))))
                assert np.linalg.norm(found.tip - point) <= TASK.tolerance
                assert found.stability >= TASK.margin


def test_the_exact_rod_agrees_with_the_poses_that_hold_the_task_loads(outcome):
    for held in (outcome.nominal, outcome.largest):
        rod = exact(PAPER, TASK, held)
        assert rod.distance < TASK.tolerance + 1.1e-4  # largest error of the paper's sub-links
        assert rod.margin == pytest.approx(float(held.margins.min()), abs=2e-3)


def test_the_largest_held_load_is_where_a_required_minimum_is_reached(outcome):
    assert outcome.nominal.load == 1.0 < outcome.load == outcome.largest.load
    assert "mm/s is below 4 mm/s" in outcome.why
    assert 4.0e-3 <= outcome.largest.dexterities.min() < 4.1e-3


def test_stiffer_tubes_hold_a_proportionally_larger_load():
    stiffer = tuple(tube.model_copy(update={"bending_stiffness": 1.5 * tube.bending_stiffness}) for tube in PAPER.tubes)
    more = evaluate(PAPER.model_copy(update={"tubes": stiffer}), TASK, "load")
    # All tubes are stiffer by the same factor: they have the same shapes under a load larger by this factor.
    assert more.load == pytest.approx(1.5 * evaluate(PAPER, TASK, "load").load, rel=0.01)


def test_a_task_point_out_of_reach_is_reported_and_costs_more_when_farther():
    def far(z):
        return evaluate(PAPER, TASK.model_copy(update={"points": ((0.0, 0.0, z),)}), "load")

    near, far_off = far(0.32), far(0.42)
    assert (near.load, near.nominal) == (0.0, None)
    assert "at point 1 without load: the tip stays" in near.why
    # The straight robot would be 298 mm long, but the robot is bent.
    assert 0.022 < near.distance < far_off.distance
    assert 0.0 < cost(near, "load") < cost(far_off, "load")


def test_a_robot_below_the_required_stiffness_holds_no_load():
    outcome = evaluate(PAPER, TASK.model_copy(update={"stiffness": 30.0}), "load")
    assert outcome.load == 0.0
    assert "N/m is below 30 N/m" in outcome.why
