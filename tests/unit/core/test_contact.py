"""A force on the shaft instead of the tip, in the model and in the exact rod."""

import math

import numpy as np
import pytest

from core.errors import PoseError
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Section

JOINTS = np.array([0.6, 2.0, -0.0763])
WRENCH = np.array([0.3, -0.2, 0.1, 0.004, -0.003, 0.005])
ARC_LENGTHS = [0.004, 0.0737, 0.165]


@pytest.mark.parametrize("integrator", ["paper", "fourth_order"])
@pytest.mark.parametrize("s", ARC_LENGTHS)
def test_the_model_under_a_shaft_force_agrees_with_the_exact_rod(paper_robot, s, integrator):
    found = Statics(paper_robot, 0.0025, integrator).solve(JOINTS, WRENCH, contact=s)
    exact = ExactRod(paper_robot, tolerance=1e-11)
    expected = exact.solve(JOINTS, WRENCH, contact=s)

    np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=6e-6)
    np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=5e-5)
    assert found.stability == pytest.approx(exact.stability(JOINTS, WRENCH, expected, s), rel=1e-4)


@pytest.mark.parametrize("integrator", ["paper", "fourth_order"])
@pytest.mark.parametrize("s", [s for s in ARC_LENGTHS if s != 0.0737])  # a section ends there: a kink
def test_j_and_c_under_a_shaft_force_are_the_derivatives_of_the_resolved_tip(paper_robot, s, integrator):
    """For the derivative by the force, the arc length of the contact from the plate is constant."""
    model = Statics(paper_robot, 0.010, integrator)
    solution = model.solve(JOINTS, WRENCH, contact=s)
    for k in range(9):
        move = 1e-6 * np.eye(9)[k]
        up = model.solve(JOINTS + move[:3], WRENCH + move[3:], contact=s).tip
        down = model.solve(JOINTS - move[:3], WRENCH - move[3:], contact=s).tip
        column = np.hstack((solution.jacobian, solution.compliance))[:3, k]
        np.testing.assert_allclose(column, (up - down) / 2e-6, rtol=0, atol=2e-6 * max(1.0, np.abs(column).max()))


def test_only_the_tip_moment_remains_beyond_the_contact_of_a_shaft_force(paper_robot):
    model = Statics(paper_robot)
    shape = model.shape(model.solve(JOINTS, WRENCH, contact=0.1))
    beyond = shape[shape[:, 0] >= 0.1 + 1e-12]

    np.testing.assert_allclose(beyond[:, 17:20], np.tile(WRENCH[3:], (len(beyond), 1)), rtol=0, atol=1e-9)
    assert np.linalg.norm(shape[0, 17:20] - WRENCH[3:]) > 0.01


def test_the_deflection_of_a_straight_tube_under_a_shaft_force_matches_beam_theory(one_tube):
    """The tip deflects by F a^2 (3 L - a) / (6 EI) under a small force F at the arc length a."""
    force, at, length = 1e-3, 0.09, 0.15
    solution = Statics(one_tube(Section(0.2)), 0.0025).solve(
        np.array([0.0, -0.05]), np.array([force, 0.0, 0.0, 0.0, 0.0, 0.0]), contact=at
    )
    assert solution.tip[0] == pytest.approx(force * at**2 * (3 * length - at) / (6 * 0.04), rel=3e-4)


def test_a_contact_at_the_tip_is_equivalent_to_a_tip_load(paper_robot):
    model = Statics(paper_robot)
    length = 0.303 + JOINTS[2]
    at_end, at_tip = (model.solve(JOINTS, WRENCH, contact=s) for s in (length - 1e-12, None))
    np.testing.assert_allclose(at_end.tip, at_tip.tip, rtol=0, atol=1e-9)


def test_a_moving_contact_is_followed_by_warm_starts(paper_robot):
    model, near = Statics(paper_robot), None
    for s in np.linspace(0.02, 0.2, 20):
        near, cold = model.solve(JOINTS, WRENCH, near, s), model.solve(JOINTS, WRENCH, contact=s)
        np.testing.assert_allclose(near.tip, cold.tip, rtol=0, atol=1e-9)
        assert near.contact == s


@pytest.mark.parametrize("s", [-0.01, 0.25, math.nan, -math.inf])
@pytest.mark.parametrize("start", ["cold", "warm"])
def test_a_contact_beyond_the_robot_is_refused_with_its_bounds(paper_robot, s, start):
    for solver in (Statics(paper_robot), ExactRod(paper_robot)):
        near = solver.solve(JOINTS, WRENCH) if start == "warm" else None
        with pytest.raises(PoseError, match=r"contact at .* mm is outside 0 \.\.\. 226\.7 mm"):
            solver.solve(JOINTS, WRENCH, near, s)
