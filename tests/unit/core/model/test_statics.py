"""The loaded model and its derivatives, against exact values, re-solved differences and symmetries."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from core.errors import DescriptionError, NoSolution, NotFinite, PoseError
from core.model.cosserat import ExactRod
from core.model.statics import RESIDUAL_TOLERANCE, Statics
from core.robot.robot import Robot, Section, Tube

FINE = 0.0025
UNLOADED = np.zeros(6)
BLOCKS = {"position": slice(0, 3), "rotation": slice(3, 6)}


def largest_error(found, expected) -> float:
    """Return the largest difference between two arrays, divided by the largest expected entry."""
    return np.abs(found - expected).max() / np.abs(expected).max()


class TestExactTips:
    @pytest.mark.parametrize(
        ("sublink", "mean", "worst"),
        [(0.020, 0.20e-3, 0.27e-3), (0.010, 0.05e-3, 0.07e-3), (0.005, 0.013e-3, 0.018e-3), (FINE, 3.3e-6, 4.5e-6)],
    )
    def test_tip_errors_match_a_second_order_scheme(self, paper_robot, exact_tips, sublink, mean, worst):
        model = Statics(paper_robot, sublink)
        errors = [np.linalg.norm(model.solve(joints, wrench).tip - tip) for joints, wrench, tip in exact_tips]

        assert np.mean(errors) < mean
        assert max(errors) < worst

    @given(
        turns=st.tuples(st.floats(-7.0, 7.0), st.floats(-7.0, 7.0)),
        translation=st.floats(-0.1379, 0.0),
        force=st.tuples(*3 * [st.floats(-0.34, 0.34)]),
    )
    @settings(max_examples=40, deadline=None)
    def test_a_cold_start_anywhere_is_within_the_papers_accuracy(self, paper_robot, turns, translation, force):
        """Forces are up to 0.6 N. The test is intentionally random in every run."""
        joints, wrench = np.array([*turns, translation]), np.array([*force, 0.0, 0.0, 0.0])
        solution = Statics(paper_robot).solve(joints, wrench)
        assert np.linalg.norm(solution.tip - ExactRod(paper_robot).solve(joints, wrench).tip) < 0.15e-3
        assert solution.stability > 0.0

    def test_a_tip_moment_agrees_with_the_exact_rod(self, paper_robot, poses):
        model, exact = Statics(paper_robot, FINE), ExactRod(paper_robot)
        for joints, wrench in poses(seed=12, count=10, force=0.5, moment=0.03):
            found, expected = model.solve(joints, wrench), exact.solve(joints, wrench)
            np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=8e-6)
            np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=5e-5)

    def test_three_tubes_agree_with_the_exact_rod(self, three_tubes):
        model, exact = Statics(three_tubes, FINE), ExactRod(three_tubes)
        random = np.random.default_rng(13)
        for _ in range(8):
            turn, wrench = random.uniform(-np.pi, np.pi, 3), random.normal(scale=3 * [0.2] + 3 * [0.01])
            joints = np.array(
                [turn[0], random.uniform(-0.09, -0.03), turn[1], random.uniform(-0.03, -0.01), turn[2], 0]
            )
            found, expected = model.solve(joints, wrench), exact.solve(joints, wrench)
            np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=1e-5)
            np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=5e-5)


class TestDerivatives:
    def test_jacobian_and_compliance_match_an_independent_prototype(self, paper_robot):
        """The expected numbers are central differences of re-solved tips of an independent prototype."""
        joints, wrench = np.array([0.0, np.pi / 2, -0.075]), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
        jacobian = [[0.042281, 0.005308, 0.255580], [0.005541, 0.022191, -0.273378], [-0.008890, 0.006513, 0.886618]]
        upper = [0.042502, 0.002744, -0.009264, 0.042615, 0.011886, 0.006001]

        solution = Statics(paper_robot, FINE).solve(joints, wrench)

        np.testing.assert_allclose(solution.jacobian[:3], jacobian, rtol=0, atol=1e-5)
        np.testing.assert_allclose(solution.compliance[:3, :3][np.triu_indices(3)], upper, rtol=0, atol=1e-5)

    @pytest.mark.parametrize(
        ("integrator", "sublink", "error"),
        [("paper", None, 1e-6), ("fourth_order", 0.010, 2e-6), ("fourth_order", 0.030, 2e-6)],
    )
    def test_jacobian_and_compliance_are_the_derivatives_of_the_resolved_tip(
        self, paper_robot, three_tubes, poses, differences, integrator, sublink, error
    ):
        joints = np.array([0.5, -0.0613, 2.0, -0.0207, -1.0, -0.005])
        cases = [(three_tubes, joints, np.array([0.2, -0.1, 0.15, 0.01, -0.005, 0.004]))]
        cases += [(paper_robot, *case) for case in poses(seed=14, count=6, force=0.5, moment=0.02)]
        for robot, joints, wrench in cases:
            model = Statics(robot, sublink, integrator)
            solution = model.solve(joints, wrench)
            jacobian, compliance = differences(model, joints, wrench)
            turns = [joint.motion == "rotation" for joint in robot.joints]
            for rows in BLOCKS.values():
                for columns in (turns, np.logical_not(turns)):
                    assert largest_error(solution.jacobian[rows, columns], jacobian[rows, columns]) < error
                for columns in BLOCKS.values():
                    assert largest_error(solution.compliance[rows, columns], compliance[rows, columns]) < error

    def test_the_sensitivity_is_the_derivative_of_the_base_unknowns(self, paper_robot):
        model = Statics(paper_robot)
        at, wrench = np.array([0.6, 2.0, -0.0763]), np.array([0.3, -0.2, 0.1, 0.004, -0.003, 0.005])
        solution, step = model.solve(at, wrench), 1e-6

        for k in range(9):
            moved = step * np.eye(9)[k]
            up = model.solve(at + moved[:3], wrench + moved[3:]).unknowns
            down = model.solve(at - moved[:3], wrench - moved[3:]).unknowns
            expected = (up - down) / (2 * step)
            np.testing.assert_allclose(
                solution.sensitivity[:, k], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max()
            )


class TestSymmetry:
    """Rotating robot and load about z must rotate the result; physics implies this, but the integrator does not."""

    @pytest.mark.parametrize("angle", [-2.9, 2 * math.pi])
    def test_turning_both_tubes_and_the_load_turns_tip_and_derivatives(self, paper_robot, poses, angle):
        model, turn = Statics(paper_robot), Rotation.from_euler("z", angle).as_matrix()
        both = np.kron(np.eye(2), turn)
        for joints, wrench in poses(seed=16, count=4, force=0.5, moment=0.02):
            here = model.solve(joints, wrench)
            there = model.solve(joints + np.array([angle, angle, 0.0]), both @ wrench)
            np.testing.assert_allclose(there.tip, turn @ here.tip, rtol=0, atol=1e-9)
            np.testing.assert_allclose(there.rotation, turn @ here.rotation, rtol=0, atol=1e-8)
            np.testing.assert_allclose(there.jacobian, both @ here.jacobian, rtol=0, atol=1e-6)
            np.testing.assert_allclose(there.compliance, both @ here.compliance @ both.T, rtol=0, atol=1e-6)

    @given(
        turns=st.tuples(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi)),
        translation=st.floats(-0.125, -0.01),
        force=st.tuples(*3 * [st.floats(-0.3, 0.3)]),
        moment=st.tuples(*3 * [st.floats(-0.01, 0.01)]),
    )
    @settings(max_examples=20, derandomize=True, deadline=None, database=None)
    def test_the_derivative_of_a_rotation_about_z_is_exact_at_any_pose(
        self, paper_robot, turns, translation, force, moment
    ):
        joints, wrench = np.array([*turns, translation]), np.array([*force, *moment])

        solution = Statics(paper_robot, 0.005).solve(joints, wrench)

        assert solution.residual <= RESIDUAL_TOLERANCE
        np.testing.assert_allclose(solution.tip, ExactRod(paper_robot).solve(joints, wrench).tip, rtol=0, atol=0.05e-3)
        np.testing.assert_allclose(solution.rotation @ solution.rotation.T, np.eye(3), rtol=0, atol=1e-12)
        # d(rotated tip) = J (1, 1, 0) + C d(rotated load) = e_z x tip, and the frame rotates by e_z.
        z = np.array([0.0, 0.0, 1.0])
        turned_load = np.r_[np.cross(z, force), np.cross(z, moment)]
        expected = np.r_[np.cross(z, solution.tip), z]
        found = solution.jacobian[:, 0] + solution.jacobian[:, 1] + solution.compliance @ turned_load
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


class TestSolve:
    def test_a_warm_start_finds_the_solution_of_a_cold_start(self, paper_robot):
        model, near = Statics(paper_robot), None
        for tick in range(60):
            joints = np.array([0.010 * tick, 1.5 - 0.007 * tick, -0.1 + 3e-4 * tick])
            wrench = np.array([0.4 * np.sin(0.05 * tick), 0.2, -0.1, 0.005, 0.01 * np.cos(0.1 * tick), 0.0])
            near, cold = model.solve(joints, wrench, near), model.solve(joints, wrench)
            np.testing.assert_allclose(near.tip, cold.tip, rtol=0, atol=1e-9)
            # a warm start omits the pass that would also update J and C by the last step
            assert largest_error(near.jacobian, cold.jacobian) < 3e-5
            assert largest_error(near.compliance, cold.compliance) < 3e-5
            assert near.iterations <= cold.iterations or tick == 0

    @pytest.mark.parametrize("integrator", ["paper", "fourth_order"])
    def test_a_steady_motion_takes_one_pass_per_tick_within_the_tolerance(self, paper_robot, integrator):
        """The solve does not verify the end conditions with another pass; recomputed, they are satisfied."""
        model = Statics(paper_robot, integrator=integrator)
        move, wrench = np.array([0.010, -0.010, 3e-4]), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
        at, near, passes = np.array([-0.3, 1.8, -0.112]), None, []
        for tick in range(60):
            near = model.solve(at + tick * move, wrench, near)
            passes.append(near.iterations)
            assert model.residual(near) <= min(RESIDUAL_TOLERANCE, near.residual + 1e-12)
            again = model.solve(at + tick * move, wrench, near)
            assert np.linalg.norm(again.tip - near.tip) < 1e-12
        assert passes[3:].count(1) > 50

    def test_the_reported_residual_bounds_the_actual_one(self, paper_robot, poses):
        model = Statics(paper_robot)
        for scale in (1e-5, 1e-4, 1e-3, 1e-2):
            for joints, wrench in poses(seed=20, count=20, force=0.5, moment=0.02):
                near = model.solve(joints, wrench)
                moved = model.solve(joints + scale * np.array([1.0, -1.0, -0.01]), (1.0 - scale) * wrench, near)
                assert model.residual(moved) <= moved.residual + 1e-13
                assert moved.residual <= RESIDUAL_TOLERANCE

    def test_singular_values_are_those_of_the_position_rows(self, paper_robot):
        solution = Statics(paper_robot).solve(np.array([0.0, 1.0, -0.1]), UNLOADED)
        expected = np.linalg.svd(solution.jacobian[:3])[1]
        np.testing.assert_allclose(solution.singular_values, expected)

    @pytest.mark.parametrize("force", [3.0, 8.0])
    def test_a_load_that_turns_the_tip_back_is_solved(self, paper_robot, force):
        joints, wrench = np.array([0.3, 1.0, -0.05]), np.array([force, 0.0, 0.0, 0.0, 0.0, 0.0])
        wrench[2] = -force
        found = Statics(paper_robot, integrator="fourth_order", sublink=0.005).solve(joints, wrench)
        assert found.rotation[2, 2] < 0.0
        assert Statics(paper_robot, 0.005, "fourth_order").residual(found) < 1e-9

    def test_a_solve_from_a_distant_solution_succeeds(self, paper_robot, poses):
        model = Statics(paper_robot, FINE)
        far = model.solve(np.array([0.0, 0.0, -0.02]), np.array([-0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
        exact = ExactRod(paper_robot)
        for joints, wrench in poses(seed=17, count=6, force=0.3):
            tip = model.solve(joints, wrench, far).tip
            np.testing.assert_allclose(tip, exact.solve(joints, wrench).tip, rtol=0, atol=8e-6)

    def test_the_moment_at_the_plate_balances_the_load(self, paper_robot, poses):
        model = Statics(paper_robot)
        for joints, wrench in poses(seed=19, count=20, force=0.5, moment=0.02):
            solution = model.solve(joints, wrench)
            balance = np.cross(solution.tip, wrench[:3]) + wrench[3:]
            np.testing.assert_allclose(solution.unknowns[2:], balance, rtol=0, atol=2e-9)

    def test_a_solution_keeps_its_pose_when_the_caller_changes_the_arrays(self, paper_robot):
        model = Statics(paper_robot)
        joints, wrench = np.array([0.0, 1.0, -0.1]), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
        solution = model.solve(joints, wrench)
        joints[:], wrench[:] = [1.0, 1.0, -0.02], 0.0

        np.testing.assert_allclose(model.shape(solution)[-1, 10:13], solution.tip, rtol=0, atol=1e-12)


class TestPlacesWhereSectionsMeet:
    """Section ends that coincide with each other or with the plate create links of zero length."""

    WRENCH = np.array([0.1, 0.2, 0.1, 0.01, 0.0, 0.005])

    @pytest.fixture
    def robot(self, paper_robot) -> Robot:
        """Return the paper's robot with a short outer tube: its sections end at 50 and 100 mm."""
        outer = Tube("short", (Section(0.05), Section(0.05, (4.0, 0.0))), 0.048, 0.30, 2.45e-3, 2.1e-3)
        return Robot("short", (paper_robot.tubes[0], outer), paper_robot.joints)

    @pytest.mark.parametrize(
        "translation",
        [0.0, -0.05, -0.1, -0.1 + 1e-12, -0.1 - 1e-12, -0.15, -0.15 + 1e-12, -0.15 - 1e-12, -0.16, -0.2029],
        ids=[
            "at the plate",
            "inner curve begins where the outer tube ends",
            "inner curve begins where the outer curve begins",
            "just beyond",
            "just before",
            "inner curve begins at the plate",
            "just in front of the plate",
            "just behind the plate",
            "part of the inner curve behind the plate",
            "only the tip looks out of the outer tube",
        ],
    )
    def test_poses_with_coincident_section_ends_are_solved(self, robot, translation):
        joints = np.array([0.4, 1.9, translation])

        solution = Statics(robot, FINE).solve(joints, self.WRENCH)

        np.testing.assert_allclose(solution.tip, ExactRod(robot).solve(joints, self.WRENCH).tip, rtol=0, atol=6e-6)
        assert np.isfinite(solution.jacobian).all()

    @pytest.mark.parametrize("first", [-0.005, -0.008], ids=["link in the middle", "first and last link"])
    def test_the_tip_is_continuous_where_the_number_of_sublinks_changes(self, paper_robot, first):
        model, step = Statics(paper_robot, 0.010), 1e-7
        for count in range(13):  # the link is a whole number of sub-links long
            translations = first - 0.010 * count + step * np.array([-1.0, 0.0, 1.0])
            below, at, above = (model.solve(np.array([0.4, 1.9, z]), self.WRENCH).tip for z in translations)
            assert np.abs(above - 2 * at + below).max() < 1e-9

    def test_a_curve_wholly_retracted_into_the_guide_agrees_with_the_exact_rod(self, one_tube):
        robot = one_tube(Section(0.05, (8.0, 0.0)), Section(0.15, (1.0, 0.0)))
        for translation in (-0.05, -0.07):
            joints = np.array([0.5, translation])
            found, expected = (solver.solve(joints, self.WRENCH) for solver in (Statics(robot, FINE), ExactRod(robot)))
            np.testing.assert_allclose(found.tip, expected.tip, rtol=0, atol=1e-6)


class TestRefusals:
    """Cold and warm solves refuse invalid input; a valid nearby solution must not change that."""

    JOINTS = np.array([0.0, 1.0, -0.1])

    @pytest.fixture(params=[Statics, ExactRod])
    def solver(self, paper_robot, request):
        return request.param(paper_robot)

    @pytest.fixture(params=["cold", "warm"])
    def near(self, solver, request):
        return solver.solve(self.JOINTS, UNLOADED) if request.param == "warm" else None

    @pytest.mark.parametrize(
        ("joints", "wrench", "error", "words"),
        [
            (JOINTS, [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0], NotFinite, r"tip wrench .*nan.*six finite numbers"),
            (JOINTS, [0.0, 0.0, 0.0, 0.0, 0.0, -math.inf], NotFinite, r"tip wrench .*-inf.*six finite numbers"),
            (JOINTS, [0.0] * 3, NotFinite, r"tip wrench .*six finite numbers"),
            (JOINTS, [[0.0] * 6], NotFinite, r"tip wrench .*six finite numbers"),
            ([-0.1] * 2, UNLOADED, PoseError, r"shape \(2,\); 'paper' needs \(3,\)"),
            ([-0.1] * 7, UNLOADED, PoseError, r"shape \(7,\); 'paper' needs \(3,\)"),
            ([0.0, math.nan, -0.1], UNLOADED, PoseError, "inner_rotation is nan"),
            ([0.0, 1.0, math.inf], UNLOADED, PoseError, "inner_translation is inf"),
            ([0.0, 0.0, 0.005], UNLOADED, PoseError, "'inner' starts at 5 mm"),
            ([0.0, 0.0, -0.31], UNLOADED, PoseError, "'inner' ends at -7 mm"),
            ([0.0, 0.0, -0.4], UNLOADED, PoseError, "'inner' ends at -97 mm"),
            (JOINTS, [0.0, 0.0, 0.0, 1e9, 0.0, 0.0], NoSolution, r"1000000000\.0"),
        ],
    )
    def test_an_invalid_pose_or_wrench_and_a_load_out_of_reach_are_refused(
        self, solver, near, joints, wrench, error, words
    ):
        with pytest.raises(error, match=words):
            solver.solve(np.array(joints), np.array(wrench), near)

    @pytest.mark.parametrize("step", [0.0, -0.010, math.nan, math.inf])
    @pytest.mark.parametrize(("kind", "name"), [(Statics, "sublink"), (ExactRod, "step")])
    def test_an_invalid_step_length_is_refused_by_name_and_value(self, paper_robot, kind, name, step):
        with pytest.raises(DescriptionError, match=f"{name} {step:g} m must be finite and greater than 0"):
            kind(paper_robot, step)
