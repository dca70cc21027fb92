"""Integration along the tubes matches closed forms and the exact rod; the fourth order matches the Euler form."""

import math

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from core.errors import DescriptionError, NoSolution
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from tests.harness.euler_angles import euler_tip

FINE = 0.0025
UNLOADED = np.zeros(6)
#: Solvers with the largest error of a closed form [m].
SOLVERS = pytest.mark.parametrize(
    ("solver", "error"), [(lambda robot: Statics(robot, FINE), 1e-5), (ExactRod, 1e-8)], ids=["statics", "exact rod"]
)


@SOLVERS
@pytest.mark.parametrize("rotation", [0.0, 0.3, -2.5])
@pytest.mark.parametrize("translation", [0.0, -0.02, -0.05])
def test_unloaded_tube_is_a_circular_arc_toward_minus_y_turned_by_its_rotation(
    one_tube, solver, error, rotation, translation
):
    curvature, arc = 4.0, 0.1
    robot = one_tube(Section(0.05), Section(arc, (curvature, 0.0)))

    tip = solver(robot).solve(np.array([rotation, translation]), UNLOADED).tip

    sideways = (1.0 - math.cos(curvature * arc)) / curvature
    along = 0.05 + translation + math.sin(curvature * arc) / curvature
    expected = [sideways * math.sin(rotation), -sideways * math.cos(rotation), along]
    np.testing.assert_allclose(tip, expected, rtol=0, atol=0.3 * error)


@SOLVERS
def test_a_tip_moment_bends_a_straight_tube_into_a_circle(one_tube, solver, error):
    moment, length = 0.3, 0.15

    tip = solver(one_tube(Section(0.2))).solve(np.array([0.0, -0.05]), np.r_[0.0, 0.0, 0.0, 0.0, moment, 0.0]).tip

    radius = 0.04 / moment
    angle = length / radius  # 1.1 rad
    expected = [radius * (1.0 - math.cos(angle)), 0.0, radius * math.sin(angle)]
    np.testing.assert_allclose(tip, expected, rtol=0, atol=error)


@SOLVERS
def test_an_axial_tip_moment_also_twists_the_part_behind_the_plate(one_tube, solver, error):
    moment, whole = 1e-2, 0.2

    solution = solver(one_tube(Section(whole))).solve(np.array([0.4, -0.05]), np.r_[0.0, 0.0, 0.0, 0.0, 0.0, moment])

    angle = math.atan2(solution.rotation[1, 0], solution.rotation[0, 0])
    assert angle == pytest.approx(0.4 + moment * whole * 1.30 / 0.04, abs=1e-9)
    np.testing.assert_allclose(solution.tip, [0.0, 0.0, 0.15], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("axis", "force"), [(0, 1e-3), (1, 1e-3), (0, -1e-3)])
def test_a_small_transverse_force_bends_a_straight_tube_by_f_l3_over_3_ei(one_tube, axis, force):
    robot, length = one_tube(Section(0.2)), 0.15
    wrench = np.zeros(6)
    wrench[axis] = force

    solution = Statics(robot, FINE).solve(np.array([0.7, -0.05]), wrench)

    assert solution.tip[axis] == pytest.approx(force * length**3 / (3 * 0.04), rel=3e-4)
    assert solution.compliance[axis, axis] == pytest.approx(length**3 / (3 * 0.04), rel=3e-4)
    # The end rotates about the other axis: about y for a force along x, about -x for a force along y.
    turn = solution.compliance[3 + 1 - axis, axis] * (1 if axis == 0 else -1)
    assert turn == pytest.approx(length**2 / (2 * 0.04), rel=3e-4)


def test_two_equal_opposed_tubes_are_straight():
    curved = Section(0.1, (4.0, 0.0))
    inner = Tube("inner", (Section(0.05), curved, Section(0.02)), 0.04, outer_diameter=1e-3, inner_diameter=0.5e-3)
    outer = Tube("outer", (Section(0.05), curved), 0.04, outer_diameter=2e-3, inner_diameter=1.5e-3)
    robot = Robot("pair", (inner, outer), (Joint("inner", 0, "rotation"), Joint("outer", 1, "rotation")))

    tip = Statics(robot).solve(np.array([math.pi + 0.2, 0.2]), UNLOADED).tip

    np.testing.assert_allclose(tip, [0.0, 0.0, 0.17], rtol=0, atol=1e-9)


class TestShape:
    JOINTS = np.array([0.6, 2.0, -0.075])
    WRENCH = np.array([0.3, -0.2, 0.1, 0.004, -0.003, 0.005])

    @pytest.fixture
    def model(self, paper_robot):
        return Statics(paper_robot, 0.010)

    @pytest.fixture
    def solution(self, model):
        return model.solve(self.JOINTS, self.WRENCH)

    @pytest.fixture
    def shape(self, model, solution):
        return model.shape(solution)

    def test_the_shape_starts_at_the_plate_along_z_with_tubes_twisted_behind_it(self, shape):
        assert shape[0, 0] == 0.0
        np.testing.assert_array_equal(shape[0, 1:10].reshape(3, 3), np.eye(3))
        np.testing.assert_array_equal(shape[0, 10:13], np.zeros(3))
        twist_inner, twist_outer = shape[0, 15:17]
        assert abs(twist_inner) > 0.1  # the twist is large enough for a meaningful test
        np.testing.assert_allclose(shape[0, 13:15], [2.0 + 0.075 * twist_inner, 0.6], rtol=0, atol=1e-12)
        assert twist_outer != 0.0

    def test_the_shape_ends_at_the_tip_with_the_total_length(self, shape, solution):
        frame, turn = shape[-1, 1:10].reshape(3, 3), shape[-1, 13]
        about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])

        assert shape[-1, 0] == pytest.approx(0.303 - 0.075, abs=1e-12)
        np.testing.assert_allclose(shape[-1, 10:13], solution.tip, rtol=0, atol=1e-12)
        np.testing.assert_allclose(frame @ about_z, solution.rotation, rtol=0, atol=1e-12)

    def test_no_step_of_a_shape_is_longer_than_a_sublink_and_its_chord_is_as_long(self, shape, model):
        steps, chords = np.diff(shape[:, 0]), np.linalg.norm(np.diff(shape[:, 10:13], axis=0), axis=1)

        assert (steps >= 0.0).all()
        assert steps.max() <= model.sublink + 1e-12
        np.testing.assert_allclose(chords, steps, rtol=2e-3, atol=1e-12)

    def test_the_frames_of_a_shape_are_rotations_whose_z_axes_add_up_to_the_tip(self, shape):
        frames = shape[:, 1:10].reshape(-1, 3, 3)
        squares = frames @ frames.transpose(0, 2, 1)
        np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-12)
        tip = cumulative_trapezoid(shape[:, [3, 6, 9]], shape[:, 0], axis=0)[-1]
        np.testing.assert_allclose(tip, shape[-1, 10:13], rtol=0, atol=2e-4)

    def test_the_outer_tube_keeps_its_last_twist_beyond_its_end_where_it_is_zero(self, shape):
        beyond = shape[shape[:, 0] >= 0.165 - 1e-12]

        assert len(beyond) > 2
        np.testing.assert_allclose(beyond[:, 16], 0.0, atol=1e-8)


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
    assert model.step > Statics(paper_robot).step == 0.010
    for joints, wrench, tip in exact_tips:
        assert np.linalg.norm(model.solve(joints, wrench).tip - tip) < 1e-6


def test_an_unknown_integrator_is_refused_by_name(paper_robot):
    with pytest.raises(DescriptionError, match="integrator 'euler' is unknown; choose paper or fourth_order"):
        Statics(paper_robot, integrator="euler")


def test_the_papers_euler_form_approaches_the_same_tip_to_second_order(paper_robot, poses):
    for joints, wrench in poses(seed=43, count=3, force=0.4, moment=0.01):
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
