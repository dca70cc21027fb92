"""Shapes under moments at the tip: against closed forms, and integrated by another method from the plate to the tip."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube


@pytest.fixture(scope="module")
def thin() -> Robot:
    """Return three thin tubes of a published example; a moment of 18 mN m folds their unloaded branch."""
    tubes = (
        Tube("a", (Section(0.19), Section(0.06, (25.0, 0.0))), 8.7346e-4, 0.32, 0.92e-3, 0.80e-3),
        Tube("b", (Section(0.12), Section(0.08, (10.0, 0.0))), 1.6479e-3, 0.32, 1.10e-3, 0.97e-3),
        Tube("c", (Section(0.09), Section(0.04, (7.142857, 0.0))), 5.0336e-3, 0.32, 1.40e-3, 1.20e-3),
    )
    turns = tuple(Joint(f"{tube.name} turn", i, "rotation") for i, tube in enumerate(tubes))
    slides = tuple(Joint(f"{tube.name} slide", i, "translation") for i, tube in enumerate(tubes))
    return Robot("thin", tubes, turns + slides)


def integrated(robot: Robot, joints: np.ndarray, unknowns: np.ndarray, moment: np.ndarray):
    """Integrate the tubes from the plate with rotation matrices in the frame of the innermost tube.

    Returns the tip [m], and the largest violation of the end conditions, torsion times GJ and moment [N m].
    """
    q, (alpha, beta) = len(robot.tubes), robot.tube_poses(joints)
    ei = np.array([tube.bending_stiffness for tube in robot.tubes])
    gj = ei / np.array([tube.stiffness_ratio for tube in robot.tubes])
    length = np.array([tube.length for tube in robot.tubes]) + beta
    borders = {0.0, *length.tolist()}
    for i, tube in enumerate(robot.tubes):
        borders |= set((beta[i] + np.cumsum([section.length for section in tube.sections])).tolist())
    marks = sorted(b for b in borders if 0.0 <= b <= length[0])
    marks = [b for k, b in enumerate(marks) if k == 0 or b - marks[k - 1] > 1e-9]

    def curvature(i: int, at: float) -> np.ndarray:
        ends = beta[i] + np.cumsum([section.length for section in robot.tubes[i].sections])
        return np.array(robot.tubes[i].sections[int(np.searchsorted(ends, at))].curvature)

    theta = alpha - beta * unknowns[:q]
    state = np.concatenate((np.zeros(3), Rotation.from_euler("z", theta[0]).as_matrix().ravel(), theta, unknowns[:q]))
    torques = np.zeros(q)
    for start, end in itertools.pairwise(marks):
        middle = 0.5 * (start + end)
        present = [i for i in range(q) if length[i] > middle]
        free = {i: curvature(i, middle) for i in present}

        def rate(_: float, y: np.ndarray, present=present, free=free) -> np.ndarray:
            frame, theta, u = y[3:12].reshape(3, 3), y[12 : 12 + q], y[12 + q :]
            turn = {i: theta[i] - theta[0] for i in present}
            spin = {i: np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]) for i, a in turn.items()}
            own = (sum(ei[i] * spin[i] @ free[i] for i in present) + (frame.T @ moment)[:2]) / ei[present].sum()
            bend = np.array([own[0], own[1], u[0]])
            across = np.array([[0, -bend[2], bend[1]], [bend[2], 0, -bend[0]], [-bend[1], bend[0], 0]])
            twist = np.zeros(q)
            for i in present:
                local = spin[i].T @ own
                twist[i] = ei[i] / gj[i] * (local[0] * free[i][1] - local[1] * free[i][0])
            d_theta = np.array([u[i] if i in present else 0.0 for i in range(q)])
            return np.concatenate((frame[:, 2], (frame @ across).ravel(), d_theta, twist))

        state = solve_ivp(rate, (start, end), state, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        for i in range(q):
            if abs(length[i] - end) < 1e-9:
                torques[i] = gj[i] * state[12 + q + i]
    torques[0] -= state[3:12].reshape(3, 3)[:, 2] @ moment
    return state[:3], float(np.abs(torques).max())


def test_shapes_under_moments_in_every_direction_are_equilibria_of_another_integrator(thin):
    """Under such moments a quarter of the poses had no shape while only forces were relaxed."""
    random, model, found = np.random.default_rng(0), Statics(thin), 0
    while found < 12:
        slides = random.uniform([-0.24, -0.19, -0.12], 0.0)
        pose = np.concatenate((random.uniform(-3.1, 3.1, 3), slides))
        if not thin.is_valid_pose(pose):
            continue
        direction = random.standard_normal(3)
        moment = random.uniform(0.01, 0.03) * direction / np.linalg.norm(direction)
        solved = model.solve(pose, np.concatenate((np.zeros(3), moment)))
        tip, violation = integrated(thin, pose, solved.unknowns, moment)

        assert solved.stability > 0.0
        # The sub-links' error at a bend of several turns; another branch would differ by centimetres.
        np.testing.assert_allclose(solved.tip, tip, rtol=0, atol=2e-3)
        assert violation < 2e-3 * np.linalg.norm(moment) + 2e-5
        found += 1


@pytest.mark.parametrize("turns", [0.2, 1.0, 2.5])
@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (-0.6, 0.0, 0.8), (0.3, -0.5, 0.2)])
def test_a_straight_tube_under_a_moment_is_a_helix(one_tube, turns, direction):
    """Without force the moment is constant, so the tangent turns about it at the rate |M| / EI."""
    robot, ei, length = one_tube(Section(0.1), bending_stiffness=0.04), 0.04, 0.08
    axis = np.array(direction) / np.linalg.norm(direction)
    moment = turns * 2.0 * math.pi / length * ei * axis
    along = axis[2] * length * axis
    across = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    angle = 2.0 * math.pi * turns
    tip = along + length / angle * (math.sin(angle) * across + (1.0 - math.cos(angle)) * np.cross(axis, across))

    solved = Statics(robot, 0.001, "fourth_order").solve(np.array([0.3, length - 0.1]), np.r_[0.0, 0.0, 0.0, moment])

    np.testing.assert_allclose(solved.tip, tip, rtol=0, atol=1e-5)
