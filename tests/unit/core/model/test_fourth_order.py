"""The fourth-order integrator for long sub-links, compared with the paper's Euler form."""

import numpy as np
import pytest

from core.errors import DescriptionError, NoSolution
from core.model.cosserat import ExactRod
from core.model.statics import DEFAULT_SUBLINKS_M, Statics
from core.robot.robot import Section
from tests.harness.euler_angles import euler_tip


def largest_error(found, expected) -> float:
    return np.abs(found - expected).max() / np.abs(expected).max()


def test_the_fourth_order_error_falls_sixteen_times_per_halving_of_the_sublink(paper_robot, exact_tips):
    exact = ExactRod(paper_robot, step=0.001, tolerance=1e-12)
    truth = [exact.solve(joints, wrench).tip for joints, wrench, _ in exact_tips]
    errors = []
    for sublink in (0.040, 0.020, 0.010):
        model = Statics(paper_robot, sublink, "fourth_order")
        errors.append(
            np.mean([np.linalg.norm(model.solve(j, w).tip - t) for (j, w, _), t in zip(exact_tips, truth, strict=True)])
        )
    # Links shorter than a sub-link are not halved, so the first halving improves less.
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 16.0, rtol=0.35)


def test_the_default_fourth_order_sublink_is_within_a_micrometre(paper_robot, exact_tips):
    model = Statics(paper_robot, integrator="fourth_order")
    assert model.step == DEFAULT_SUBLINKS_M["fourth_order"] > Statics(paper_robot).step == DEFAULT_SUBLINKS_M["paper"]
    for joints, wrench, tip in exact_tips:
        assert np.linalg.norm(model.solve(joints, wrench).tip - tip) < 1e-6


@pytest.mark.parametrize("sublink", [0.010, 0.030])
def test_j_and_c_of_the_fourth_order_integrator_are_the_derivatives_of_the_resolved_tip(
    paper_robot, three_tubes, poses, differences, sublink
):
    cases = [(paper_robot, *case) for case in poses(seed=41, count=12, force=0.5, moment=0.02)]
    joints = np.array([0.5, -0.0613, 2.0, -0.0207, -1.0, -0.005])
    cases.append((three_tubes, joints, np.array([0.2, -0.1, 0.15, 0.01, -0.005, 0.004])))
    for robot, joints, wrench in cases:
        model = Statics(robot, sublink, "fourth_order")
        solution = model.solve(joints, wrench)
        jacobian, compliance = differences(model, joints, wrench)
        for rows in (slice(0, 3), slice(3, 6)):
            assert largest_error(solution.jacobian[rows], jacobian[rows]) < 2e-6
            assert largest_error(solution.compliance[rows], compliance[rows]) < 2e-6


def test_the_fourth_order_compliance_to_a_force_is_nearly_symmetric(paper_robot, poses):
    model = Statics(paper_robot, integrator="fourth_order")
    for joints, wrench in poses(seed=42, count=20, force=0.5):
        block = model.solve(joints, wrench).compliance[:3, :3]
        assert largest_error(block, block.T) < 1e-5


def test_an_unknown_integrator_is_refused_by_name(paper_robot):
    with pytest.raises(DescriptionError, match="integrator 'euler' is unknown; choose paper or fourth_order"):
        Statics(paper_robot, integrator="euler")


def test_the_papers_euler_form_approaches_the_same_tip_to_second_order(paper_robot, poses):
    for joints, wrench in poses(seed=43, count=8, force=0.4, moment=0.01):
        apart = []
        for sublink in (0.005, 0.0025, 0.00125):
            solution = Statics(paper_robot, sublink).solve(joints, wrench)
            apart.append(np.linalg.norm(euler_tip(paper_robot, solution, sublink) - solution.tip))
        assert apart[0] < 0.03e-3
        np.testing.assert_allclose(np.divide(apart[:-1], apart[1:]), 4.0, rtol=0.25)


def test_the_euler_form_raises_at_its_singularity_where_the_model_still_solves(one_tube):
    robot = one_tube(Section(0.05), Section(0.2, (0.0, 0.5 * np.pi / 0.2)))
    joints = np.array([0.0, 0.0])

    solution = Statics(robot).solve(joints, np.zeros(6))

    assert abs(solution.rotation[0, 2]) == pytest.approx(1.0, abs=1e-6)  # the tangent at the tip is along x
    assert np.isfinite(solution.jacobian).all()
    with pytest.raises(NoSolution, match=r"cos\(theta_2\)"):
        euler_tip(robot, solution, 0.002)
