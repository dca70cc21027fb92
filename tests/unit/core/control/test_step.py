"""One tick: a pure function from a sample to an estimate and a command that are always finite."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.control.controller_settings import Controller
from core.control.controllers import INNER_LOOPS, Strategy, strategy
from core.control.estimation import Actuation, Estimator
from core.control.observer import Observer, RateFilter
from core.control.step import set_origin, start_controller, step
from core.control.stiffness import TipStiffness
from core.control.tip_residual import TipResidual, inputs_of, residual_at, write_inputs
from core.control.trajectories import JointMotion, Setpoint
from core.errors import CtrError, DescriptionError, NotFinite
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits, Workspace
from tests.harness.exact_plant import HERE, PERIOD, ExactPlant, run

POSE = np.array([0.0, math.pi / 2, -0.1])
SPEED = math.radians(20.0)
TRAVEL = (
    JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
    JointLimit("inner_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
    JointLimit("inner_translation", "m", -0.130, -0.005, 0.020, 0.100),
)


def controller(robot, name="dual_layer", inner="type_2", observes=True, others=(), k=2.5, lag=0.0, exact=False):
    estimator = Estimator(RateFilter(PERIOD, 5.0), Observer(PERIOD), Actuation(PERIOD, 0.0, lag))
    return Controller(
        Statics(robot), strategy(name, k, k, True, inner), Limits(TRAVEL, others=others), estimator, observes, exact
    )


def plant_of(robot, joints=POSE) -> ExactPlant:
    return ExactPlant(robot, joints)


def pull(time: float) -> np.ndarray:
    return np.array([0.15 * (1.0 - math.cos(0.8 * time)), 0.0, 0.0])


@pytest.fixture(scope="module")
def pulled(paper_robot):
    """Return ticks and tips of the default controller under a varying load."""
    return run(controller(paper_robot), plant_of(paper_robot), 3.2, force=pull)


def test_dual_layer_control_keeps_the_tip_in_place_under_a_varying_load(pulled):
    """The load deflects the uncontrolled tip by 9 mm; the error that remains is the lag of the rate filter."""
    assert np.abs(pulled.tips).max() < 2.5e-4


@pytest.mark.parametrize(("inner", "observes"), [("type_1", False), ("type_1_exact", True), ("type_2", False)])
def test_every_inner_loop_keeps_the_tip_in_place_under_a_varying_load(paper_robot, inner, observes):
    """The load rises fastest after 2 s, and the run ends half a second later."""
    tips = run(controller(paper_robot, inner=inner, observes=observes), plant_of(paper_robot), 2.5, force=pull).tips

    assert np.abs(tips).max() < 2.5e-4


def test_differentiated_tracker_frames_keep_the_tip_in_place_under_a_varying_load(paper_robot):
    """Tracker frames have no noise here; the error that remains is the tip's motion within one and a half frames."""
    unit = replace(controller(paper_robot, observes=False), differentiates=True)
    tips = run(unit, plant_of(paper_robot), 2.5, force=pull).tips

    assert np.abs(tips).max() < 5e-4


def test_tip_with_a_stiffness_gives_way_by_force_over_stiffness_and_returns(paper_robot):
    stiffness = (40.0, 60.0, 300.0)
    unit = replace(controller(paper_robot), stiffness=TipStiffness(stiffness))
    push = np.array([0.1, 0.1, 0.0])
    ticks, _, _, tips, _ = run(
        unit, plant_of(paper_robot), 12.0, force=lambda time: push if time < 6.0 else np.zeros(3)
    )

    np.testing.assert_allclose(tips[2999], push / stiffness, atol=1e-4)
    np.testing.assert_allclose(tips[-1], 0.0, atol=1e-4)
    assert max(np.linalg.norm(tick.memory.offset.position) for tick in ticks) < 0.006


def test_tip_gives_way_along_its_own_axis_by_force_over_stiffness(paper_robot):
    """The exact rod has its own frame of the tip, 32 deg from the world's z here."""
    stiffness, plant = (60.0, 40.0, 400.0), plant_of(paper_robot)
    unit = replace(controller(paper_robot), stiffness=TipStiffness(stiffness, frame="tip"))
    axis = plant.rod.solve(plant.joints, np.zeros(6)).rotation[:, 2]
    assert axis[2] < 0.86
    tips = run(unit, plant, 6.0, force=lambda _: 0.3 * axis).tips

    turned = plant.rod.solve(plant.joints, np.r_[plant.force, np.zeros(3)]).rotation
    np.testing.assert_allclose(
        tips[-1], turned @ np.diag(1.0 / np.array(stiffness)) @ turned.T @ plant.force, atol=2e-5
    )
    assert tips[-1] @ axis == pytest.approx(0.3 / 400.0, rel=0.02)


def test_stiffness_of_a_setpoint_replaces_that_of_the_controller(paper_robot):
    unit = replace(controller(paper_robot), stiffness=TipStiffness((20.0, 20.0, 200.0)))
    order = HERE._replace(stiffness=TipStiffness((40.0, 40.0, 200.0)))
    force = np.array([0.1, 0.0, 0.0])
    ticks, _, _, tips, _ = run(unit, plant_of(paper_robot), 6.0, lambda _: order, lambda _: force)

    np.testing.assert_allclose(tips[-1], [0.1 / 40.0, 0.0, 0.0], atol=1e-4)
    assert ticks[-1].setpoint.stiffness == order.stiffness


def test_stiffness_is_refused_without_control_of_the_tip_position(paper_robot):
    for unit in (controller(paper_robot, "inner_loop"), controller(paper_robot, k=0.0)):
        with pytest.raises(DescriptionError, match="strategy 'dual_layer' with k1 = k2 above 0"):
            replace(unit, stiffness=TipStiffness((20.0, 20.0, 20.0)))


def test_stiffness_that_contact_does_not_allow_is_refused_before_a_motion(paper_robot):
    with pytest.raises(DescriptionError, match="multiply the stiffness by"):
        replace(controller(paper_robot, lag=0.02), stiffness=TipStiffness((1.0, 1.0, 1.0))).check_loops(POSE)


def test_tip_approaches_a_step_setpoint_at_the_rate_of_equation_31(paper_robot):
    k = 2.5
    unit = controller(paper_robot, k=k)
    tips = run(unit, plant_of(paper_robot), 2.0, lambda _: Setpoint(np.array([0.0, 0.0, 1e-3]), np.zeros(3))).tips

    times = PERIOD * np.arange(len(tips))
    np.testing.assert_allclose(tips[:, 2], 1e-3 * (1.0 - np.exp(-k * times)), rtol=0, atol=2e-5)
    np.testing.assert_allclose(tips[:, :2], 0.0, atol=2e-5)


def test_tip_follows_a_ramp_with_feedforward_without_lag_despite_delayed_commands(paper_robot):
    late = 10
    unit, plant = controller(paper_robot, lag=late * PERIOD), plant_of(paper_robot)
    memory = set_origin(unit, start_controller(unit, plant.sample()), plant.solved().tip)
    start, waiting, slope, error = plant.solved().tip, [np.zeros(3)] * late, np.array([0.0, 1e-3, 3e-3]), np.zeros(3)
    for number in range(1000):
        time = number * PERIOD
        tick = step(unit, memory, plant.sample(number % 13 == 0), Setpoint(time * slope, slope))
        memory = tick.memory
        error = plant.solved().tip - start - time * slope
        waiting.append(tick.command)
        plant.obey(waiting.pop(0))
        plant.sent = tick.command

    np.testing.assert_allclose(error, 0.0, atol=1e-5)  # a tip that lags by 20 ms would be 60 um behind


def test_delta_1_and_delta_2_add_up_to_the_whole_deflection(paper_robot):
    ticks = run(
        controller(paper_robot), plant_of(paper_robot), 2.0,
        lambda time: Setpoint(np.array([0.0, 0.0, 3e-3 * time]), np.array([0.0, 0.0, 3e-3])), pull,
    ).ticks  # fmt: skip
    now = ticks[-1].memory.estimate

    assert np.abs(now.known.delta_2).max() > 1e-4
    np.testing.assert_allclose(now.known.delta_1 + now.known.delta_2, now.known.deflection, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(now.known.deflection, now.loaded.tip - now.unloaded.tip)


def test_exact_and_filtered_deflection_rates_match_the_derivative_of_the_deflection(pulled):
    known = [tick.memory.estimate.known for tick in pulled.ticks]
    middle = 1470
    true = (known[middle + 20].deflection - known[middle - 20].deflection) / (40 * PERIOD)

    np.testing.assert_allclose(known[middle].deflection_rate_raw, true, rtol=0, atol=2e-5)
    # Both rates pass through the 5 Hz filter, which delays them by 45 ms.
    np.testing.assert_allclose(known[middle].deflection_rate, true, rtol=0, atol=2e-4)
    np.testing.assert_allclose(known[middle].deflection_rate_exact, true, rtol=0, atol=2e-4)


def test_observed_velocity_matches_the_tip_and_delta_is_its_difference_from_u_int(pulled):
    ticks, tips = pulled.ticks[:1500], pulled.tips[:1500]
    true = (tips[-1] - tips[-41]) / (40 * PERIOD)

    np.testing.assert_allclose(ticks[-20].memory.estimate.known.velocity_observed, true, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(ticks[-1].delta, ticks[-1].memory.estimate.known.velocity_observed - ticks[-1].u_int)


def test_measured_tip_is_constant_between_tracker_frames_while_the_observed_tip_moves(paper_robot):
    unit, plant = controller(paper_robot), plant_of(paper_robot)
    memory = start_controller(unit, plant.sample())
    first = plant.now.tip
    for _ in range(10):
        plant.obey(np.array([0.0, 0.0, 0.01]))
        memory = step(unit, memory, plant.sample(frame=False), HERE).memory

    assert memory.tip.tolist() == first.tolist()
    np.testing.assert_allclose(memory.estimate.observed.tip, plant.solved().tip, rtol=0, atol=1e-5)
    assert np.linalg.norm(plant.solved().tip - first) > 1e-4


def test_controller_tick_without_an_order_sends_zero_velocity_and_updates_the_estimates(paper_robot):
    unit, plant = controller(paper_robot), plant_of(paper_robot)
    memory = start_controller(unit, plant.sample())
    plant.force = np.array([0.2, 0.0, 0.0])

    tick = step(unit, memory, plant.sample(), None)

    assert not tick.command.any()
    assert tick.memory.estimate.known.deflection[0] > 5e-3
    assert (tick.memory.origin + tick.setpoint.position).tolist() == tick.memory.tip.tolist()


def test_commanded_joint_motion_is_executed_within_the_joint_limits(paper_robot):
    unit, plant = controller(paper_robot), plant_of(paper_robot, np.array([0.0, math.pi / 2, -0.0051]))
    memory = start_controller(unit, plant.sample())

    tick = step(unit, memory, plant.sample(), JointMotion(np.array([0.1, -9.0, 0.01])))

    assert tick.command[:2].tolist() == [0.1, -SPEED]
    assert 0.0 < tick.command[2] < 0.002
    assert tick.at_bound.tolist() == [0.0, -1.0, 1.0]
    assert unit.limits.active(plant.joints, tick.at_bound, tick.at_row) == (
        "speed of inner_rotation (0.3491 rad/s)",
        "travel of inner_translation (-0.005 m)",
    )


def test_workspace_stops_the_tip_at_its_face_and_reports_the_active_row(paper_robot):
    plant = plant_of(paper_robot)
    tip = plant.solved().tip
    face = float(tip[2]) + 2e-3
    unit = controller(paper_robot, others=(Workspace((-1.0, -1.0, 0.0), (1.0, 1.0, face)),))

    ticks, _, _, tips, _ = run(unit, plant, 2.5, lambda _: Setpoint(np.array([0.0, 0.0, 5e-3]), np.zeros(3)))

    assert tips[:, 2].max() <= 2e-3 + 1e-5
    assert tips[-1, 2] == pytest.approx(2e-3, abs=2e-5)
    assert f"workspace z <= {face:g} m" in unit.limits.active(plant.joints, ticks[-1].at_bound, ticks[-1].at_row)


def test_workspace_stops_a_joint_motion_whose_joints_are_far_from_their_ends(paper_robot):
    plant = plant_of(paper_robot)
    face = float(plant.solved().tip[2]) + 4e-3
    unit = controller(paper_robot, others=(Workspace((-1.0, -1.0, 0.0), (1.0, 1.0, face)),))
    memory, active = start_controller(unit, plant.sample()), False
    for _ in range(2500):
        tick = step(unit, memory, plant.sample(), JointMotion(np.array([0.0, 0.0, 0.002])))
        memory, active = tick.memory, active or bool(tick.at_row.any())
        plant.obey(tick.command)
    tip = plant.solved().tip
    assert active
    assert face - 1e-3 < tip[2] < face + 0.1e-3  # without the limit the tip moves by 10 mm


@pytest.mark.parametrize("what", ["joints", "sent", "wrenches", "tip", "setpoint"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_controller_tick_with_a_number_that_is_not_finite_is_refused(paper_robot, what, bad):
    unit, plant = controller(paper_robot), plant_of(paper_robot)
    memory = start_controller(unit, plant.sample())
    sample, order = plant.sample(), Setpoint(np.zeros(3), np.zeros(3))
    (order.position if what == "setpoint" else getattr(sample, what))[...] = bad

    with pytest.raises(CtrError):
        step(unit, memory, sample, order)


@pytest.mark.parametrize("tip", [None, np.array([0.0, math.nan, 0.3])])
def test_controller_does_not_start_without_a_finite_tracker_frame(paper_robot, tip):
    with pytest.raises(NotFinite, match="tracker frame is needed"):
        start_controller(controller(paper_robot), plant_of(paper_robot).sample()._replace(tip=tip))


@pytest.mark.parametrize("observes", [False, True])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("inner", INNER_LOOPS)
def test_custom_loops_receive_the_same_inputs_as_built_in_loops(paper_robot, inner, exact, observes):
    usual = controller(paper_robot, "dual_layer", inner, observes, lag=0.012, exact=exact)
    own = replace(usual, strategy=Strategy(usual.strategy.outer, lambda u, view: usual.strategy.inner(u, view)))
    assert own.strategy.laws is None
    plant = plant_of(paper_robot)
    plant.force = np.array([0.1, 0.05, 0.0])
    memory = start_controller(usual, plant.sample())
    for _ in range(5):
        plant.force += np.array([0.01, 0.0, 0.0])
        memory = step(usual, memory, plant.sample(), HERE).memory
    order = Setpoint(np.array([1e-3, -2e-3, 3e-3]), np.array([2e-3, 0.0, 1e-3]))
    sample = plant.sample()
    first, second = (step(each, memory, sample, order) for each in (usual, own))

    np.testing.assert_allclose(first.command, second.command, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(first.u_int, second.u_int, rtol=1e-12)
    np.testing.assert_allclose(first.sigma, second.sigma, rtol=1e-9)


@pytest.fixture(scope="module")
def residual(paper_robot):
    """Return a residual of half a millimetre around the start pose, without and under load."""
    inputs, at_rest, force = inputs_of(paper_robot), np.zeros(3), np.zeros(3)
    support = np.empty((1, len(inputs.table)))
    write_inputs(inputs.table, inputs.frame_joint, np.eye(3), POSE, at_rest, force, support[0])
    weights, scales = np.array([[3e-4, -4e-4, 0.0]]), np.full(len(inputs.table), 2.0)
    return TipResidual(inputs, np.eye(3), scales, support, weights, np.eye(1), 1.0, 1e-3)


def test_a_residual_moves_tip_and_jacobian_of_the_model_and_the_observer_subtracts_it_from_the_bias(
    paper_robot, residual
):
    plain = controller(paper_robot)
    learned = replace(plain, estimator=replace(plain.estimator, residual=residual))
    ticks, others = (run(each, plant_of(paper_robot), 0.4, force=pull).ticks for each in (learned, plain))
    known, model = ticks[-1].memory.estimate, others[-1].memory.estimate
    value, jacobian, by_force = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    at = known.loaded.joints, known.known.directions, known.loaded.wrench[:3]
    share = residual_at(residual.packed(), *at, value, jacobian, by_force)
    solved = plain.statics.solve(known.loaded.joints, known.loaded.wrench, model.loaded)

    assert np.linalg.norm(value) > 0.4e-3
    np.testing.assert_array_equal(known.known.residual, value)
    assert known.known.residual_state.tolist() == [share, 1.0, 0.0]
    np.testing.assert_allclose(known.loaded.tip - solved.tip, value, atol=1e-6)
    np.testing.assert_allclose(known.loaded.jacobian[:3] - solved.jacobian[:3], jacobian, atol=1e-5)
    np.testing.assert_allclose(known.known.bias + value, model.known.bias, atol=2e-5)
    np.testing.assert_allclose(known.observed.tip, model.observed.tip, atol=2e-5)


def test_a_wrong_residual_is_switched_off_and_the_tip_stays_where_the_tracker_is(paper_robot, residual):
    wrong = residual._replace(weights=6.0 * residual.weights)
    plain = controller(paper_robot)
    learned = replace(plain, estimator=replace(plain.estimator, residual=wrong))
    found = run(learned, plant_of(paper_robot), 3.2, force=pull)

    assert found.ticks[-1].memory.estimate.known.residual_state[1] == 0.0
    assert not found.ticks[-1].memory.estimate.known.residual.any()
    assert np.abs(found.tips).max() < 2e-3
    assert np.abs(found.tips[-1]).max() < 0.1e-3
