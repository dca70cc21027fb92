"""Tests of the control strategies of the paper's section III: their equations, compared with the loaded model."""

import math

import numpy as np
import pytest

from core.control.controllers import INNER_LOOPS, LoopInputs, VelocityMode, strategy
from core.control.trajectories import Setpoint
from core.errors import DescriptionError
from core.model.statics import Statics

POSE = np.array([0.2, 1.7, -0.08])
FORCE, FORCE_RATE = np.array([0.3, -0.1, 0.05]), np.array([0.05, 0.02, -0.03])
JOINT_RATE = np.array([0.01, -0.02, 0.003])


@pytest.fixture(scope="module")
def model(paper_robot):
    return Statics(paper_robot)


@pytest.fixture(scope="module")
def view(model) -> LoopInputs:
    """Return the inputs of an inner loop while the joints move at JOINT_RATE and the force changes at FORCE_RATE.

    The rate of the deflection under load is a central difference of model tips. `drift` is an arbitrary vector.
    """
    h = 1e-4

    def solved(time: float, load: float):
        return model.solve(POSE + time * JOINT_RATE, np.r_[load * (FORCE + time * FORCE_RATE), np.zeros(3)])

    def deflection(time: float) -> np.ndarray:
        return solved(time, 1.0).tip - solved(time, 0.0).tip

    loaded = solved(0.0, 1.0)
    return LoopInputs(
        loaded,
        solved(0.0, 0.0),
        (deflection(h) - deflection(-h)) / (2 * h),
        loaded.compliance[:3, :3] @ FORCE_RATE,
        np.array([2e-4, -1e-4, 3e-4]),
    )


@pytest.fixture(scope="module")
def tip_rate(model) -> np.ndarray:
    """Return the model's tip velocity (3,) [m/s] while joints and force change at JOINT_RATE and FORCE_RATE."""
    h = 1e-4
    ahead, behind = (
        model.solve(POSE + s * h * JOINT_RATE, np.r_[FORCE + s * h * FORCE_RATE, np.zeros(3)]).tip for s in (1, -1)
    )
    return (ahead - behind) / (2 * h)


@pytest.mark.parametrize("inner", ["type_1", "type_1_exact"])
def test_joint_velocity_from_a_type_1_loop_gives_the_requested_tip_velocity(inner, view, tip_rate):
    """The requested tip velocity is that of a motion at JOINT_RATE while the force changes at FORCE_RATE.

    The equation of a `type_1` or `type_1_exact` loop compensates the tip motion that the force causes, so its solution
    must be JOINT_RATE.
    """
    jacobian, velocity = INNER_LOOPS[inner](tip_rate, view)

    np.testing.assert_allclose(np.linalg.solve(jacobian, velocity), JOINT_RATE, rtol=0, atol=2e-6)


def test_loaded_jacobian_strategy_misses_the_tip_motion_that_the_load_causes(view, tip_rate):
    jacobian, velocity = strategy("loaded_jacobian").inner(tip_rate, view)

    assert np.abs(np.linalg.solve(jacobian, velocity) - JOINT_RATE).max() > 1e-3


def test_type_2_compensates_every_tip_motion_not_caused_by_the_joints(view):
    u_int = np.array([1e-3, 0.0, -2e-3])
    # Tip velocity X' that an observer estimates: the parts from the joints, from the load, and from neither (drift).
    measured = view.loaded.jacobian[:3] @ JOINT_RATE + view.load_rate + view.drift

    jacobian, velocity = INNER_LOOPS["type_2"](u_int, view)

    # eq. (29) of the paper
    expected = np.linalg.solve(view.loaded.jacobian[:3], u_int - (measured - view.loaded.jacobian[:3] @ JOINT_RATE))
    np.testing.assert_allclose(np.linalg.solve(jacobian, velocity), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "loaded"), [("unloaded_jacobian", False), ("loaded_jacobian", True)])
def test_jacobian_strategies_use_only_their_jacobian_and_no_load_rate(name, loaded, view):
    u_int = np.array([1e-3, 2e-3, 3e-3])

    jacobian, velocity = strategy(name).inner(u_int, view)

    assert velocity.tolist() == u_int.tolist()
    np.testing.assert_array_equal(jacobian, (view.loaded if loaded else view.unloaded).jacobian[:3])


@pytest.mark.parametrize("name", ["unloaded_jacobian", "loaded_jacobian", "inner_loop"])
def test_velocity_strategies_ignore_the_measured_tip(name):
    setpoint = Setpoint(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]))

    requested = strategy(name, 2.0, 3.0, True).outer.tip_velocity(setpoint, np.full(3, 9.0))

    assert isinstance(strategy(name).outer, VelocityMode)
    assert requested.tolist() == [0.1, 0.2, 0.3]


def test_dual_layer_is_equation_30_with_a_separate_gain_per_term():
    setpoint, tip = Setpoint(np.array([1.0, 0.0, 2.0]), np.array([0.5, 0.0, 0.0])), np.array([0.25, 1.0, 0.0])

    assert strategy("dual_layer", 2.0, 3.0).outer.tip_velocity(setpoint, tip).tolist() == [2.5, -2.0, 6.0]
    assert strategy("dual_layer", 2.0, 3.0, True).outer.tip_velocity(setpoint, tip).tolist() == [3.0, -2.0, 6.0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: strategy("dual"), "strategy 'dual' is unknown; choose one of unloaded_jacobian, loaded_jacobian"),
        (lambda: strategy("dual_layer", inner="type_3"), "inner loop 'type_3' is unknown; choose one of type_1,"),
        (lambda: strategy("dual_layer", -0.1), "K1 = -0.1 1/s is outside 0 ... 50 1/s"),
        (lambda: strategy("dual_layer", 2.5, math.nan), "K2 = nan 1/s is outside 0 ... 50 1/s"),
        (lambda: strategy("inner_loop", 51.0), "K1 = 51 1/s"),
    ],
)
def test_invalid_strategy_is_refused_with_name_value_and_bound(make, words):
    with pytest.raises(DescriptionError) as refused:
        make()

    assert words in str(refused.value)
