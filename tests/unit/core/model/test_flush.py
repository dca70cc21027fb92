"""Two tubes whose ends are flush: the model then has links of zero length, and both tubes share the tip."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube

INTEGRATORS = [("paper", 0.0025, 1e-5), ("fourth_order", None, 2e-6)]
SLIDE = np.array([0.0, 0.0, 1.0])
WRENCH = np.array([0.2, -0.1, 0.15, 0.01, -0.005, 0.004])


@pytest.fixture
def drawn_in(paper_robot):
    """Return joints at which both tubes end at 165 mm; the inner tube's lengths sum to slightly less by rounding."""
    joints = np.array([0.4, 1.9, 0.165 - 0.303])
    _, beta = paper_robot.tube_poses(joints)
    assert abs(beta[0] + paper_robot.tubes[0].length - paper_robot.tubes[1].length) < 1e-15
    return joints


@pytest.mark.parametrize(("integrator", "sublink", "tolerance"), INTEGRATORS)
@pytest.mark.parametrize("rounding", [-1e-16, 0.0, 1e-16])
def test_the_tip_of_flush_tubes_matches_the_exact_rod(paper_robot, drawn_in, integrator, sublink, tolerance, rounding):
    joints = drawn_in + rounding * SLIDE
    tip = ExactRod(paper_robot).solve(joints, WRENCH).tip
    np.testing.assert_allclose(
        Statics(paper_robot, sublink, integrator).solve(joints, WRENCH).tip, tip, rtol=0, atol=tolerance
    )


@pytest.mark.parametrize(("integrator", "sublink", "tolerance"), INTEGRATORS)
@pytest.mark.parametrize("rounding", [-1e-16, 0.0, 1e-16])
def test_the_jacobian_of_flush_tubes_matches_extending_the_inner_tube(
    paper_robot, drawn_in, integrator, sublink, tolerance, rounding
):
    found = Statics(paper_robot, sublink, integrator).solve(drawn_in + rounding * SLIDE, WRENCH)
    exact, step = ExactRod(paper_robot, tolerance=1e-12), 1e-4
    at = [exact.solve(drawn_in + k * step * SLIDE, WRENCH).tip for k in range(3)]
    slide = (-3.0 * at[0] + 4.0 * at[1] - at[2]) / (2.0 * step)  # one-sided difference of second order
    np.testing.assert_allclose(found.jacobian[:3, 2], slide, rtol=0, atol=2e-3)
    for k in (0, 1):
        turn = 1e-5 * np.eye(3)[k]
        turned = (exact.solve(drawn_in + turn, WRENCH).tip - exact.solve(drawn_in - turn, WRENCH).tip) / 2e-5
        np.testing.assert_allclose(found.jacobian[:3, k], turned, rtol=0, atol=2e-4)


def test_fixed_flush_tubes_act_like_one_tube_of_their_mean_curvature():
    """Two equal tubes at a relative angle of 0.6 rad without torsion: each bends as the mean of both precurvatures.

    The tubes are curved along their whole length, so nothing twists where GJ is far above EI.
    """
    bent = Section(0.1, (8.0, 0.0))
    inner = Tube("inner", (bent,), 0.04, -0.999, 1e-3, 0.5e-3, rotation=0.6)
    outer = Tube("outer", (bent,), 0.04, -0.999, 2e-3, 1.2e-3)
    robot = Robot("two", (inner, outer), (Joint("outer_rotation", 1, "rotation"),))
    kappa = 8.0 * math.cos(0.3)
    radius, angle = 1.0 / kappa, 0.1 * kappa
    # A precurvature (1/r, 0) bends toward -y; the mean curvature is rotated by 0.3 rad.
    aside = radius * (1.0 - math.cos(angle))
    tip = [aside * math.sin(0.3), -aside * math.cos(0.3), radius * math.sin(angle)]
    solved = Statics(robot, integrator="fourth_order").solve(np.zeros(1), np.zeros(6))
    np.testing.assert_allclose(solved.tip, tip, rtol=0, atol=3e-6)


def test_three_flush_tubes_match_the_exact_rod(three_tubes):
    lengths = np.array([tube.length for tube in three_tubes.tubes])
    joints = np.array([0.3, 0.08 - lengths[0], 1.0, 0.08 - lengths[1], -0.5, 0.08 - lengths[2]])
    for k in range(1, 4):
        wrench = k / 3.0 * WRENCH
        tip = ExactRod(three_tubes).solve(joints, wrench).tip
        found = Statics(three_tubes, integrator="fourth_order").solve(joints, wrench)
        np.testing.assert_allclose(found.tip, tip, rtol=0, atol=2e-6)
        assert found.residual < 1e-9


def test_a_tube_that_ends_inside_its_outer_tube_is_refused(paper_robot):
    short = replace(paper_robot.tubes[0], sections=(Section(0.1649999),), translation=0.0)
    joints = tuple(joint for joint in paper_robot.joints if joint.motion == "rotation")
    with pytest.raises(
        Exception, match=r"'inner' ends at 165 mm, but must end beyond the end of tube 'outer' at 165 mm"
    ):
        replace(paper_robot, tubes=(short, paper_robot.tubes[1]), joints=joints)
