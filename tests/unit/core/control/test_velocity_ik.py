import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from core.control.velocity_ik import (
    ADAPTIVE_DAMPING_M_S,
    SIGMA_FLOOR_M_S,
    NullSpace,
    VelocityLimits,
    VelocityTask,
    inverse,
    inverse_law,
)
from core.errors import NotFinite
from core.model.statics import Statics

#: The paper's robot at (0, pi/2, -0.075) under 0.2 N.
JACOBIAN = np.array([[0.0423, 0.0053, 0.2556], [0.0055, 0.0222, -0.2734], [-0.0089, 0.0065, 0.8866]])
SPEED = np.array([0.35, 0.35, 0.020])


def damped(jacobian, desired, speed) -> tuple[np.ndarray, np.ndarray]:
    """Return the least-squares problem in v / speed, damped near singular poses as by Nakamura and Hanafusa."""
    scaled = jacobian * speed
    smallest = np.linalg.svd(scaled, compute_uv=False)[-1]
    floor = max(SIGMA_FLOOR_M_S, math.sqrt(ADAPTIVE_DAMPING_M_S * np.linalg.norm(desired)))
    damping = floor * np.sqrt(max(0.0, 1.0 - (smallest / floor) ** 2))
    joints = speed.size
    return np.vstack([scaled, damping * np.eye(joints)]), np.r_[desired, np.zeros(joints)]


def near_singular(random: np.random.Generator, joints: int) -> np.ndarray:
    """Return a Jacobian whose columns become equal at a singular pose."""
    jacobian = random.normal(size=(3, joints)) * [0.05, 0.05, 1.0][:joints]
    jacobian[:, 1] = jacobian[:, 0] + 10.0 ** random.uniform(-7, -1) * random.normal(size=3)
    return jacobian


@pytest.mark.parametrize("seed", range(3))
def test_velocity_inverse_without_active_limits_equals_the_plain_inverse(seed):
    desired = 1e-3 * np.random.default_rng(seed).normal(size=3)

    found = inverse(JACOBIAN, desired, SPEED, -SPEED, SPEED)

    np.testing.assert_allclose(found.velocity, np.linalg.solve(JACOBIAN, desired), rtol=1e-8, atol=1e-12)
    assert not found.at_bound.any()


def test_sigma_contains_the_singular_values_of_the_jacobian_in_units_of_top_speed():
    sigma = inverse(JACOBIAN, np.zeros(3), SPEED, -SPEED, SPEED).sigma

    gram = np.linalg.eigvalsh((JACOBIAN * SPEED) @ (JACOBIAN * SPEED).T)
    np.testing.assert_allclose(sigma, np.sqrt(gram[::-1]), rtol=1e-6)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_velocity_inverse_with_bounds_is_the_bounded_damped_least_squares_solution(joints):
    random = np.random.default_rng([41, joints])
    bounded = 0
    for case in range(60):
        jacobian = random.normal(size=(3, joints)) * [0.05, 0.05, 1.0][:joints]
        if case % 3 == 0 and joints > 1:
            jacobian = near_singular(random, joints)
        speed, desired = SPEED[:joints], random.normal(size=3) * 10.0 ** random.uniform(-4, -1)
        lower, upper = -speed * random.uniform(0.01, 1.0, joints), speed * random.uniform(0.01, 1.0, joints)

        found = inverse(jacobian, desired, speed, lower, upper)

        matrix, right = damped(jacobian, desired, speed)
        best = lsq_linear(matrix, right, (lower / speed, upper / speed), method="bvls", tol=1e-14)
        np.testing.assert_allclose(found.velocity / speed, best.x, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(found.at_bound[best.active_mask != 0], best.active_mask[best.active_mask != 0])
        bounded += found.at_bound.any()
    assert bounded > 6


@pytest.mark.parametrize("joints", [4, 6])
def test_redundant_joints_reach_the_desired_velocity_by_the_smallest_motion(joints):
    random = np.random.default_rng([42, joints])
    speed = np.resize([0.35, 0.020], joints)
    for _ in range(40):
        jacobian = random.normal(size=(3, joints)) * np.resize([0.05, 1.0], joints)
        desired = 1e-4 * random.normal(size=3)

        found = inverse(jacobian, desired, speed, -speed, speed)

        smallest = speed * (np.linalg.pinv(jacobian * speed) @ desired)
        np.testing.assert_allclose(found.velocity / speed, smallest / speed, rtol=0, atol=1e-5)


@pytest.mark.parametrize("joints", [4, 6])
def test_redundant_joints_compensate_joints_at_their_velocity_bounds(joints):
    random = np.random.default_rng([43, joints])
    speed = np.resize([0.35, 0.020], joints)
    for _ in range(40):
        jacobian = random.normal(size=(3, joints)) * np.resize([0.05, 1.0], joints)
        desired = random.normal(size=3) * 10.0 ** random.uniform(-3, -1)
        lower, upper = -speed * random.uniform(0.01, 1.0, joints), speed * random.uniform(0.01, 1.0, joints)

        found = inverse(jacobian, desired, speed, lower, upper)

        matrix, right = damped(jacobian, desired, speed)
        best = lsq_linear(matrix, right, (lower / speed, upper / speed), method="bvls", tol=1e-12)
        left = np.linalg.norm(matrix @ (found.velocity / speed) - right)
        assert (found.velocity >= lower).all()
        assert (found.velocity <= upper).all()
        assert left <= np.sqrt(2.0 * best.cost) + 1e-6 * np.linalg.norm(desired)


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_joint_velocities_at_a_singular_pose_stay_bounded_and_reachable_motion_continues(rank):
    random = np.random.default_rng([44, rank])
    left, right = np.linalg.qr(random.normal(size=(3, 3)))[0], np.linalg.qr(random.normal(size=(3, 3)))[0]
    jacobian = left @ np.diag([0.010] * rank + [0.0] * (3 - rank)) @ right.T / SPEED
    desired = left @ np.full(3, 1e-3)  # the desired velocity is equal in each direction, reachable or not
    endless = 1e6 * SPEED

    found = inverse(jacobian, desired, SPEED, -endless, endless)

    moved = left.T @ jacobian @ found.velocity
    np.testing.assert_allclose(moved[:rank], 1e-3, rtol=5e-3)
    np.testing.assert_allclose(moved[rank:], 0.0, atol=1e-9)
    assert np.abs(found.velocity / SPEED).max() < 0.2


def test_joint_velocities_are_bounded_by_the_damping_near_the_aligned_pose_of_the_paper(paper_robot):
    model, endless = Statics(paper_robot), 1e6 * SPEED
    for apart in np.geomspace(1e-6, 1.0, 25):
        jacobian = model.solve(np.array([0.0, apart, -0.1]), np.zeros(6)).jacobian[:3]
        for direction in np.eye(3):
            velocity = inverse(jacobian, 1e-3 * direction, SPEED, -endless, endless).velocity
            # |v / speed| <= |desired| / floor, because sigma / (sigma^2 + damping^2) is at most 1 / floor.
            assert np.linalg.norm(velocity / SPEED) <= 1e-3 / SIGMA_FLOOR_M_S * (1 + 1e-9)


@pytest.mark.parametrize("size", [1.0, 1e6, 1e13, 1e100])
def test_huge_equations_of_custom_loops_are_solved_as_exactly_as_small_ones(size):
    jacobian = size * np.array([[0.0, 3.8, 22.7], [3.8, 3.8, 3.8], [3.8, 3.8, 3.8]])
    desired = size * np.array([9.5, 9.5, 9.5])
    speed = np.array([0.35, 0.35, 0.02])

    found = inverse(jacobian, desired, speed, -speed, speed).velocity

    exact = lsq_linear(jacobian / size * speed, desired / size, bounds=(-1.0, 1.0)).x * speed
    assert np.linalg.norm(jacobian @ found - desired) / size == pytest.approx(
        np.linalg.norm(jacobian @ exact - desired) / size, rel=1e-6
    )


def test_joint_with_zero_bounds_does_not_move():
    upper = SPEED.copy()
    upper[2] = 0.0

    found = inverse(JACOBIAN, np.array([0.0, 0.0, 1e-3]), SPEED, -SPEED, upper)

    assert found.velocity[2] == 0.0
    assert found.at_bound.tolist() == [0.0, 0.0, 1.0]


def test_velocity_inverse_does_not_change_its_arguments():
    given = (JACOBIAN.copy(), np.array([0.1, -0.1, 0.1]), SPEED.copy(), -SPEED, SPEED.copy())
    before = [each.copy() for each in given]

    inverse(*given)

    for each, copy in zip(given, before, strict=True):
        np.testing.assert_array_equal(each, copy)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_velocity_inverse_refuses_numbers_that_are_not_finite_by_name(bad):
    with pytest.raises(NotFinite, match=rf"desired tip velocity .*{bad}.* m/s"):
        inverse(JACOBIAN, np.array([0.0, bad, 0.0]), SPEED, -SPEED, SPEED)
    with pytest.raises(NotFinite, match="Jacobian"):
        inverse(JACOBIAN * bad, np.zeros(3), SPEED, -SPEED, SPEED)


@pytest.mark.parametrize("joints", [3, 6])
def test_velocity_inverse_with_limits_of_several_joints_is_optimal_among_feasible_velocities(joints):
    """Compared with scipy's general solver, the result keeps all limits and is as close to the desired velocity."""
    random = np.random.default_rng([45, joints])
    speed, active = np.resize([0.35, 0.020], joints), 0
    for _ in range(25):
        jacobian = random.normal(size=(3, joints)) * np.resize([0.05, 1.0], joints)
        desired = random.normal(size=3) * 10.0 ** random.uniform(-3, -1)
        rows, room = random.normal(size=(4, joints)) / speed, random.uniform(0.0, 1.0, 4)

        found = inverse(jacobian, desired, speed, -speed, speed, rows, room)

        matrix, right = damped(jacobian, desired, speed)
        assert (rows @ found.velocity <= room + 1e-9).all()
        assert (np.abs(found.velocity) <= speed).all()
        at = found.velocity / speed
        np.testing.assert_allclose((rows @ found.velocity)[found.at_row > 0], room[found.at_row > 0], atol=1e-9)
        # A point is optimal if no feasible direction decreases the cost, because the problem is convex.
        gradient = matrix.T @ (matrix @ at - right)
        for _ in range(200):
            other = random.uniform(-1.0, 1.0, joints)
            worst = (rows @ (speed * other) / np.maximum(room, 1e-12)).max()
            other = other / max(1.0, worst)
            assert gradient @ (other - at) >= -1e-7 * np.linalg.norm(gradient) - 1e-12
        active += found.at_row.any()
    assert active > 6


def test_limit_row_with_bound_zero_blocks_its_direction_and_no_other():
    wall = JACOBIAN[2:]  # z must not increase

    found = inverse(JACOBIAN, np.array([1e-3, 0.0, 1e-3]), SPEED, -SPEED, SPEED, wall, np.zeros(1))

    np.testing.assert_allclose(JACOBIAN @ found.velocity, [1e-3, 0.0, 0.0], rtol=0, atol=1e-9)
    assert found.at_row.tolist() == [1.0]
    back = inverse(JACOBIAN, np.array([0.0, 0.0, -1e-3]), SPEED, -SPEED, SPEED, wall, np.zeros(1))
    np.testing.assert_allclose(JACOBIAN @ back.velocity, [0.0, 0.0, -1e-3], rtol=0, atol=1e-9)
    assert back.at_row.tolist() == [0.0]


def test_no_joint_moves_when_all_velocity_bounds_are_zero():
    stuck = np.vstack([np.eye(3), -np.eye(3)])

    found = inverse(JACOBIAN, np.full(3, 0.01), SPEED, -SPEED, SPEED, stuck, np.zeros(6))

    np.testing.assert_allclose(found.velocity, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_inverse_where_more_limits_than_joints_meet_uses_only_its_own_memory(seed):
    random = np.random.default_rng([43, seed])
    joints, limits = int(random.integers(2, 7)), int(random.integers(10, 46))
    alike = random.normal(size=(3, joints))[random.integers(0, 3, limits)]
    rows = alike + 10.0 ** random.uniform(-12, 0) * random.normal(size=(limits, joints))
    room = np.where(random.random(limits) < 0.7, 0.0, 1e-3 * random.random(limits))
    speed, task = np.full(joints, 0.35), (0.05 * random.normal(size=(3, joints)), 0.02 * random.normal(size=3))
    law: Any = inverse_law
    bounds = VelocityLimits(speed, -speed, speed, rows, room)
    nowhere = NullSpace(np.zeros(joints), np.empty((0, joints)))

    # Python checks each index. Compiled code would write beyond its arrays.
    found = law.py_func(VelocityTask(*task), bounds, nowhere, SIGMA_FLOOR_M_S)[0]

    assert (rows @ found <= room + 1e-9).all()
    matrix, right = damped(task[0], task[1], speed)
    assert np.linalg.norm(matrix @ (found / speed) - right) <= np.linalg.norm(right) * (1.0 + 1e-9)
