"""Loads in addition to the wrench at the tip: several point loads, weight of the tubes, and a distributed force."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from core.errors import NotFinite, PoseError
from core.model.cosserat import ExactRod, Loads
from core.robot.robot import Base, Section
from tests.harness.boundary_value import Point, boundary_value

WRENCH = np.array([0.03, -0.02, 0.01, 0.002, -0.001, 0.001])
POINTS = (
    (0.03, np.array([0.05, 0.0, -0.02])),
    (0.055, np.array([0.0, -0.08, 0.0])),
    (0.2, np.array([0.02, 0.02, 0.0])),
)
WEIGHTS = np.array([[0.3, 0.0, 0.1], [0.5, 0.0, 0.2], [0.9, 0.0, 0.3]])


@pytest.mark.parametrize("ends", [(0.09, 0.07, 0.05), (0.05, 0.07, 0.09), (0.06, 0.09, 0.04)])
@pytest.mark.parametrize("base", [Base(), Base((0.1, -0.2, 0.3), (0.4, -1.2, 0.7))])
def test_tips_under_many_loads_match_an_independent_boundary_value_solution(three_tubes, ends, base):
    robot = type(three_tubes)(three_tubes.name, three_tubes.tubes, three_tubes.joints, base)
    lengths = [tube.length for tube in robot.tubes]
    joints = np.array([0.3, ends[0] - lengths[0], 1.2, ends[1] - lengths[1], -0.5, ends[2] - lengths[2]])
    points, distributed = [point for point in POINTS if point[0] < max(ends)], np.array([0.4, -0.3, 0.0])
    everywhere = WEIGHTS + np.where(np.arange(3) == np.argmax(ends), 1.0, 0.0)[:, None] * distributed
    truth = boundary_value(robot, joints, WRENCH, points=[Point(*point) for point in points], weights=everywhere)
    rod, loads = ExactRod(robot, tolerance=1e-11), Loads(points, WEIGHTS, distributed)
    found = rod.solve(joints, WRENCH, loads=loads)

    np.testing.assert_allclose(found.tip, truth.tip, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.rotation, truth.rotation, rtol=0, atol=1e-6)
    assert rod.stability(joints, WRENCH, found, loads=loads) == pytest.approx(truth.margin, rel=1e-3)
    slopes, n = rod.derivatives(joints, WRENCH, found, loads=loads), joints.size
    np.testing.assert_allclose(slopes[:, :n], truth.jacobian, rtol=0, atol=1e-4 * np.abs(truth.jacobian).max())
    np.testing.assert_allclose(slopes[:3, n : n + 3], truth.compliance[:3, :3], rtol=0, atol=1e-6)


def test_derivatives_at_the_plate_are_those_of_leaving_it(paper_robot):
    joints, rod = np.array([0.2, 1.3, -0.303]), ExactRod(paper_robot)
    found = rod.derivatives(joints, WRENCH, rod.solve(joints, WRENCH))
    np.testing.assert_allclose(found[:3, :3], [[0, 0, 0], [0, 0, 0], [0, 0, 1]], rtol=0, atol=1e-4)


def test_a_heavy_straight_tube_hangs_as_the_elastica_under_its_own_weight(one_tube):
    """EI angle'' = -w (L - s) cos(angle) for a clamped strip with a force w per length across its start."""
    weight, length, stiffness = 40.0, 0.15, 0.04

    def bent(s, y):
        return np.vstack([y[1], -weight * (length - s) / stiffness * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])])

    s = np.linspace(0.0, length, 50)
    elastica = solve_bvp(
        bent, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), s, np.vstack([s, 0 * s, 0 * s, s]), tol=1e-9
    )
    x, z = elastica.y[2, -1], elastica.y[3, -1]
    rod, joints = ExactRod(one_tube(Section(0.2))), np.array([0.0, -0.05])
    for loads in (Loads(distributed=np.array([weight, 0, 0])), Loads(weights=np.array([[weight, 0, 0]]))):
        np.testing.assert_allclose(rod.solve(joints, np.zeros(6), loads=loads).tip, [x, 0.0, z], rtol=0, atol=1e-8)
    assert x > 0.3 * length


def test_a_point_load_at_the_tip_acts_like_the_force_of_the_wrench(paper_robot):
    joints, force, rod = np.array([0.2, 1.3, -0.08]), np.array([0.1, -0.05, 0.2]), ExactRod(paper_robot)
    end = float(paper_robot.tube_ends(joints)[0])
    one = rod.solve(joints, np.append(force, np.zeros(3)))
    for points in ([(end, force)], [(end, 0.3 * force), (end, 0.7 * force)]):
        found = rod.solve(joints, np.zeros(6), loads=Loads(points))
        np.testing.assert_allclose(found.tip, one.tip, rtol=0, atol=1e-9)
    on_shaft = rod.solve(joints, np.append(force, np.zeros(3)), contact=0.1)
    np.testing.assert_allclose(rod.solve(joints, np.zeros(6), loads=Loads([(0.1, force)])).tip, on_shaft.tip, atol=1e-9)


@pytest.mark.parametrize(
    ("loads", "error"),
    [
        (Loads([(0.3, np.zeros(3))]), PoseError),
        (Loads([(-0.001, np.zeros(3))]), PoseError),
        (Loads(distributed=np.array([0.0, np.nan, 0.0])), NotFinite),
    ],
)
def test_a_load_beyond_the_tubes_or_that_is_not_finite_is_refused(paper_robot, loads, error):
    with pytest.raises(error):
        ExactRod(paper_robot).solve(np.array([0.2, 1.3, -0.08]), np.zeros(6), loads=loads)
