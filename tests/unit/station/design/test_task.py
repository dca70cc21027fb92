"""Whether a robot holds its tip at points under loads: what is said to be held is, and by the exact rod, too."""

import numpy as np
import pytest

from core.model.statics import Statics
from station.config.robots import load_robot
from station.design.exact import exact
from station.design.study import load_study
from station.design.task import cost, done

PAPER = load_robot("paper")
TASK = load_study("fig10_load").file.task


@pytest.fixture(scope="module")
def outcome():
    return done(PAPER, TASK, "load")


def test_joints_that_hold_bring_the_tip_to_the_points_within_their_travel(outcome):
    model, limits = Statics(PAPER.robot()), PAPER.limits()
    for held in (outcome.held, outcome.most):
        for force, row in zip(TASK.forces, held.joints, strict=True):
            for point, joints in zip(TASK.points, row, strict=True):
                limits.check(joints)
                found = model.solve(joints, np.concatenate((held.load * np.array(force), np.zeros(3))))
                assert np.linalg.norm(found.tip - point) <= TASK.tolerance
                assert found.stability >= TASK.margin


def test_the_exact_rod_agrees(outcome):
    for held in (outcome.held, outcome.most):
        rod = exact(PAPER, TASK, held)
        assert rod.away < TASK.tolerance + 1.1e-4  # as far as the paper's sub-links may be from it
        assert rod.margin == pytest.approx(float(held.margins.min()), abs=2e-3)


def test_the_largest_load_ends_where_something_becomes_too_little(outcome):
    assert outcome.held.load == 1.0 < outcome.load == outcome.most.load
    assert "mm/s is below 4 mm/s" in outcome.why
    assert 4.0e-3 <= outcome.most.dexterities.min() < 4.1e-3


def test_stiffer_tubes_hold_more():
    stiffer = tuple(tube.model_copy(update={"bending_stiffness": 1.5 * tube.bending_stiffness}) for tube in PAPER.tubes)
    more = done(PAPER.model_copy(update={"tubes": stiffer}), TASK, "load")
    # All of them by as much: the same shapes under as much more load.
    assert more.load == pytest.approx(1.5 * done(PAPER, TASK, "load").load, rel=0.01)


def test_a_point_out_of_reach_is_told_and_the_farther_costs_the_more():
    def far(z):
        return done(PAPER, TASK.model_copy(update={"points": ((0.0, 0.0, z),)}), "load")

    near, far_off = far(0.32), far(0.42)
    assert (near.load, near.held) == (0.0, None)
    assert "at point 1 without load: the tip stays" in near.why
    # Straight out it is 298 mm long, but bent.
    assert 0.022 < near.away < far_off.away
    assert 0.0 < cost(near, "load") < cost(far_off, "load")


def test_what_is_too_soft_is_not_held():
    outcome = done(PAPER, TASK.model_copy(update={"stiffness": 30.0}), "load")
    assert outcome.load == 0.0
    assert "N/m is below 30 N/m" in outcome.why
