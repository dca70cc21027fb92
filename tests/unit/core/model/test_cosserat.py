"""The exact rod matches published values, closed forms and reciprocity."""

import numpy as np
from scipy.integrate import solve_bvp

from core.model.cosserat import ExactRod
from core.robot.robot import Section


def test_tips_of_the_exact_rod_match_three_solvers_to_a_micrometre(paper_robot, exact_tips):
    for joints, wrench, tip in exact_tips:
        assert np.linalg.norm(ExactRod(paper_robot).solve(joints, wrench).tip - tip) < 1e-6


def test_a_finer_step_changes_the_exact_rod_s_tip_by_less_than_a_nanometre(paper_robot, poses):
    for joints, wrench in poses(seed=21, count=4, force=0.5, moment=0.02):
        coarse, fine = (ExactRod(paper_robot, step).solve(joints, wrench) for step in (0.002, 0.0005))
        np.testing.assert_allclose(coarse.tip, fine.tip, rtol=0, atol=1e-9)


def test_a_large_tip_force_bends_a_straight_tube_into_the_elastica(one_tube):
    force, length, stiffness = 3.0, 0.15, 0.04

    def pendulum(s, y):  # EI angle'' = -F cos(angle), with x' = sin(angle), z' = cos(angle)
        angle, bend = y[0], y[1]
        return np.vstack([bend, -force / stiffness * np.cos(angle), np.sin(angle), np.cos(angle)])

    def ends(start, end):
        return np.array([start[0], end[1], start[2], start[3]])

    s = np.linspace(0.0, length, 50)
    elastica = solve_bvp(pendulum, ends, s, np.vstack([s, 0 * s, 0 * s, s]), tol=1e-9)
    assert elastica.success
    x, z = elastica.y[2, -1], elastica.y[3, -1]

    rod = ExactRod(one_tube(Section(0.2))).solve(np.array([0.0, -0.05]), np.array([force, 0.0, 0.0, 0.0, 0.0, 0.0]))

    assert x > 0.4 * length  # the deflection is large: 40 % of the length
    np.testing.assert_allclose(rod.tip, [x, 0.0, z], rtol=0, atol=1e-8)


def test_the_compliance_to_a_tip_force_is_symmetric(paper_robot, poses, differences):
    """By Maxwell and Betti, the compliance of an elastic body under a conservative load is symmetric."""
    for joints, wrench in poses(seed=22, count=2, force=0.5):
        _, compliance = differences(ExactRod(paper_robot, tolerance=1e-11), joints, wrench)
        np.testing.assert_allclose(compliance, compliance.T, rtol=0, atol=2e-5 * np.abs(compliance).max())
        force_block = compliance[:3, :3]
        np.testing.assert_allclose(force_block, force_block.T, rtol=0, atol=2e-5 * np.abs(force_block).max())


def test_a_warm_start_finds_the_solution_of_a_cold_start(paper_robot):
    exact, near = ExactRod(paper_robot), None
    for tick in range(30):
        joints = np.array([0.010 * tick, 1.5 - 0.007 * tick, -0.1 + 3e-4 * tick])
        wrench = np.array([0.4 * np.sin(0.05 * tick), 0.2, -0.1, 0.005, 0.0, 0.0])
        near, cold = exact.solve(joints, wrench, near), exact.solve(joints, wrench)
        np.testing.assert_allclose(near.tip, cold.tip, rtol=0, atol=1e-9)


def test_splitting_a_section_does_not_change_the_shape(one_tube):
    whole, cut = Section(0.10, (4.0, 1.0)), Section(0.05, (4.0, 1.0))
    joints, wrench = np.array([0.3, -0.02]), np.array([0.3, -0.2, 0.1, 0.01, 0.0, 0.005])

    tips = [ExactRod(one_tube(Section(0.05), *rest)).solve(joints, wrench).tip for rest in ([whole], [cut, cut])]

    np.testing.assert_allclose(tips[0], tips[1], rtol=0, atol=1e-9)
