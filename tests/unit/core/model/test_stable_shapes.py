"""A cold solve always finds a stable shape, and this is the shape that the robot reaches from rest."""

import itertools
import math

import numpy as np
import pytest

from core.errors import NoSolution
from core.model.cosserat import ExactRod
from core.model.relaxation import base_unknowns, cut, relax
from core.model.solution import at_rest
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from tests.measure.solver import MAX_FORCE_N, OTHER_SHAPE_M, ZERO_EIGENVALUE, continued_from_rest, draw, lowest

UNLOADED = np.zeros(6)
TURN = (Joint("inner", 0, "rotation"), Joint("outer", 1, "rotation"))

#: Poses of published three-tube robots (by their number in `draw(0)`) at which a solver that starts from
#: zero finds no shape or an unstable equilibrium; 761 and 816 have two negative directions, hence a positive margin.
UNLOADED_POSES = (281, 381, 495, 516, 585, 634, 761, 1244)
LOADED_POSES = (19, 381, 585, 684, 703, 761, 816, 1074, 1264)


def pair(steepness: float) -> Robot:
    """Return two equally curved tubes with (1 + nu) u^2 L^2 = `steepness`."""
    section = Section(0.1, (math.sqrt(steepness / 1.3) / 0.1, 0.0))
    inner = Tube("inner", (section, Section(1e-3)), 0.02, outer_diameter=1e-3, inner_diameter=0.5e-3)
    return Robot("pair", (inner, Tube("outer", (section,), 0.04, inner_diameter=1.5e-3)), TURN)


def poses(force: float, numbers: tuple[int, ...]):
    drawn = itertools.islice(draw(0, force), max(numbers) + 1)
    return [pose for number, pose in enumerate(drawn) if number in numbers]


class TestNegativeDirections:
    @pytest.mark.parametrize(("part", "count"), [(0.0, 0), (0.97, 0), (1.03, 2), (8.0, 2), (10.0, 4)])
    def test_a_compressed_straight_tube_has_two_negative_directions_per_euler_load(self, one_tube, part, count):
        """The tube buckles in x and y at once, which does not change the sign of the margin."""
        length = 0.15
        wrench = np.array([0.0, 0.0, -part * math.pi**2 * 0.04 / (4.0 * length**2), 0.0, 0.0, 0.0])
        robot, joints = one_tube(Section(0.2)), np.array([0.0, -0.05])
        model = Statics(robot, 0.0025)
        straight = model.solve(joints, wrench, at_rest(joints, math.inf, 1))

        np.testing.assert_allclose(straight.tip, [0.0, 0.0, length], rtol=0, atol=1e-12)
        assert straight.stability > 0.0
        assert model.negative_directions(straight) == count
        assert abs(lowest(robot, straight)) > ZERO_EIGENVALUE
        assert (lowest(robot, straight) > 0.0) == (count == 0)

    @pytest.mark.parametrize(("steepness", "count"), [(2.3, 0), (2.6, 1), (21.0, 1), (23.5, 2)])
    def test_opposed_tubes_have_one_negative_direction_per_odd_quarter_wave(self, steepness, count):
        """For theta'' = -(k^2) theta (no twist), k L = sqrt(steepness), the count rises at pi / 2, 3 pi / 2, ..."""
        model, joints = Statics(pair(steepness), 0.0025), np.array([math.pi, 0.0])
        untwisted = model.solve(joints, UNLOADED, at_rest(joints, math.inf, 2))

        assert np.abs(untwisted.unknowns[:2]).max() < 1e-9
        assert model.negative_directions(untwisted) == count

    @pytest.mark.parametrize("force", [0.0, MAX_FORCE_N])
    def test_negative_directions_of_a_shape_match_differences_of_the_energy(self, three_tubes, force):
        random, seen = np.random.default_rng(3), set()
        model = Statics(three_tubes, FINE, "fourth_order")
        for _ in range(12):
            turn = random.uniform(-np.pi, np.pi, 3)
            joints = np.array([turn[0], -0.15, turn[1], -0.06, turn[2], -0.02])
            wrench = np.r_[random.normal(scale=8.0 * force, size=3), 0.0, 0.0, 0.0]
            try:
                found = model.solve(joints, wrench, at_rest(joints, math.inf, 3))
            except NoSolution:
                continue
            least = lowest(three_tubes, found, FINE)
            if abs(least) > ZERO_EIGENVALUE:
                seen.add(model.negative_directions(found) == 0)
                assert (model.negative_directions(found) == 0) == (least > 0.0)
        assert True in seen


FINE = 0.0025


class TestColdStarts:
    @pytest.mark.parametrize(
        "pose", [*poses(0.0, UNLOADED_POSES), *poses(MAX_FORCE_N, LOADED_POSES)], ids=lambda pose: pose.kind
    )
    def test_cold_starts_end_at_a_stable_shape(self, pose):
        model = Statics(pose.robot)
        found = model.solve(pose.joints, pose.wrench)

        assert model.residual(found) < 1e-9
        assert found.stability > 0.0
        assert lowest(pose.robot, found) > -ZERO_EIGENVALUE

    @pytest.mark.parametrize("force", [0.0, MAX_FORCE_N])
    def test_cold_starts_find_the_shape_that_the_exact_rod_reaches_from_rest(self, force):
        compared = 0
        for pose in itertools.islice(draw(5, force), 24):
            if len(pose.robot.tubes) == 3:
                rod, calm = continued_from_rest(pose)
                if rod is not None and calm:
                    compared += 1
                    assert (
                        np.linalg.norm(Statics(pose.robot).solve(pose.joints, pose.wrench).tip - rod.tip)
                        < OTHER_SHAPE_M
                    )
        assert compared > 5

    def test_a_cold_start_beyond_euler_s_load_finds_the_buckled_shape(self, one_tube):
        """The straight shape is also an equilibrium, but an unstable one."""
        wrench = np.array([0.0, 0.0, -1.3 * math.pi**2 * 0.04 / (4.0 * 0.15**2), 0.0, 0.0, 0.0])
        found = Statics(one_tube(Section(0.2)), FINE).solve(np.array([0.0, -0.05]), wrench)

        assert np.hypot(*found.tip[:2]) > 0.05
        # the equilibrium is neutral, because the tube may buckle to any side
        assert found.stability == pytest.approx(0.0, abs=1e-6)


class TestRelaxation:
    def test_the_relaxation_error_falls_with_the_square_of_the_element_length(self, paper_robot):
        joints, force = np.array([0.4, 2.0, -0.08]), np.array([0.2, -0.1, 0.1])
        exact = ExactRod(paper_robot).solve(joints, np.r_[force, 0.0, 0.0, 0.0])
        errors = []
        for longest in (0.02, 0.01, 0.005):
            chain = cut(paper_robot, joints, np.append(force, np.zeros(3)), math.inf, longest)
            theta = np.tile(chain.alpha, (chain.ends.size, 1))
            relaxed = relax(chain, theta, np.zeros((chain.ends.size - 1, 2)))
            assert relaxed is not None
            unknowns = base_unknowns(paper_robot, chain, *relaxed)
            errors.append(np.abs(unknowns[:2] - exact.torsion).max())
            moment = np.cross(exact.tip, force)
            assert np.abs(unknowns[2:] - moment).max() < 0.2 * np.linalg.norm(force) * longest
        assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]
        assert errors[2] < 1e-3
