"""The compiled learned residual: its derivatives, its equivariance, and how it is switched off."""

import numpy as np
import pytest

from core.control.tip_residual import FADE_S, HARMFUL_S, TipResidual, inputs_of, next_gain, residual_at, write_inputs
from station.config.robots import load_robot


@pytest.fixture(params=["paper", "three_tubes", "nylon"])
def case(request):
    """Return a residual with random support points for a robot, and a pose amid them."""
    robot, random = load_robot(request.param).robot(), np.random.default_rng(1)
    inputs, base, n = inputs_of(robot), np.ascontiguousarray(robot.base.rotation), len(robot.joints)
    poses = [random.uniform(-0.3, 0.3, n) for _ in range(30)]
    pose, states, force = random.uniform(-0.1, 0.1, n), random.uniform(-0.2, 0.2, n), random.normal(0.0, 0.1, 3)
    support = np.empty((30, len(inputs.table)))
    for row, joints in zip(support, poses, strict=True):
        write_inputs(inputs.table, inputs.frame_joint, base, joints, states, random.normal(0.0, 0.1, 3), row)
    weights, explained = 1e-3 * random.standard_normal((30, 3)), 0.005 * np.eye(30) + 5e-5
    scales = np.full(len(inputs.table), 0.8)
    return TipResidual(inputs, base, scales, support, weights, explained, 0.9, 1e-3).packed(), pose, states, force


def at(packed, joints, states, force):
    value, jacobian, by_force = np.empty(3), np.empty((3, joints.size)), np.empty((3, 3))
    share = residual_at(packed, joints, states, force, value, jacobian, by_force)
    return value, jacobian, by_force, share


def test_the_derivatives_of_the_residual_are_its_difference_quotients(case):
    packed, pose, states, force = case
    value, jacobian, by_force, share = at(packed, pose, states, force)
    h = 1e-6
    joint_steps, force_steps = h * np.eye(pose.size), h * np.eye(3)

    assert 0.05 < share < 0.3  # the gate is partly open, so that its slope counts
    assert value.any()
    moved = [(at(packed, pose + d, states, force)[0] - at(packed, pose - d, states, force)[0]) for d in joint_steps]
    np.testing.assert_allclose(jacobian, np.column_stack(moved) / (2.0 * h), atol=1e-8)
    loaded = [(at(packed, pose, states, force + d)[0] - at(packed, pose, states, force - d)[0]) for d in force_steps]
    np.testing.assert_allclose(by_force, np.column_stack(loaded) / (2.0 * h), atol=1e-8)


def test_a_residual_that_enlarges_the_error_for_a_second_fades_to_zero_for_good():
    bias, value, gain, worse, gains = np.array([2e-3, 0.0, 0.0]), np.array([-1.5e-3, 0.0, 0.0]), 1.0, 0.0, []
    for _ in range(1000):
        gain, worse = next_gain(0.5e-3, 2e-3, bias, value, gain, worse)
        gains.append(gain)

    assert 2e-3 * gains.count(1.0) == pytest.approx(HARMFUL_S, abs=0.01)
    assert 2e-3 * gains.index(0.0) == pytest.approx(HARMFUL_S + FADE_S, abs=0.02)
    assert next_gain(0.5e-3, 2e-3, np.zeros(3), value, 0.0, 0.0)[0] == 0.0


@pytest.mark.parametrize("bias", [0.0, 0.6e-3, -0.7e-3])
def test_a_residual_that_is_right_or_slightly_wrong_stays_on(bias):
    gain, worse = 1.0, 0.0
    for _ in range(2000):
        gain, worse = next_gain(0.5e-3, 2e-3, np.array([bias, 0.0, 0.0]), np.array([1e-3, 0.0, 0.0]), gain, worse)

    assert gain == 1.0
