"""One tick: a pure function from a sample to an estimate and a command that are always finite."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.control.controller_settings import Controller
from core.control.controllers import INNER_LOOPS, Strategy, strategy
from core.control.estimation import Actuation, Estimator
from core.control.observer import Observer, RateFilter
from core.control.step import Sample, set_origin, start_controller, step
from core.control.stiffness import TipStiffness
from core.control.trajectories import JointMotion, Setpoint
from core.errors import CtrError, DescriptionError, NotFinite
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from core.robot.limits import JointLimit, Limits, Workspace

PERIOD = 0.002
POSE = np.array([0.0, math.pi / 2, -0.1])
SPEED = math.radians(20.0)
TRAVEL = (
    JointLimit("outer_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
    JointLimit("inner_rotation", "rad", -2 * math.pi, 2 * math.pi, SPEED, 5 * SPEED),
    JointLimit("inner_translation", "m", -0.130, -0.005, 0.020, 0.100),
)
HERE = Setpoint(np.zeros(3), np.zeros(3))


def controller(robot, name="dual_layer", inner="type_2", observes=True, others=(), k=2.5, lag=0.0, exact=False):
    estimator = Estimator(RateFilter(PERIOD, 5.0), Observer(PERIOD), Actuation(PERIOD, 0.0, lag))
    return Controller(
        Statics(robot), strategy(name, k, k, True, inner), Limits(TRAVEL, others=others), estimator, observes, exact
    )


class Plant:
    """Simulated robot with ideal sensors: an exact rod whose joints follow commands at once."""

    def __init__(self, robot, joints=POSE) -> None:
        self.rod, self.robot, self.joints = ExactRod(robot), robot, joints.copy()
        self.sent, self.force = np.zeros(3), np.zeros(3)
        self.seen = np.zeros(3)  #: true tip at the last sample [m]

    def tip(self) -> np.ndarray:
        return self.rod.solve(self.joints, np.r_[self.force, np.zeros(3)]).tip

    def sample(self, frame: bool = True) -> Sample:
        """Return a sample of all sensors; the outer tube carries the whole load, in the axes of this tube."""
        tip, angle = self.tip(), self.joints[0]
        self.seen = tip
        turn = np.array([[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1.0]])
        wrenches = np.zeros((2, 6))
        wrenches[1] = np.r_[turn @ self.force, turn @ np.cross(tip, self.force)]
        return Sample(self.joints.copy(), self.sent, wrenches, tip if frame else None, 0.0)

    def obey(self, command: np.ndarray) -> None:
        self.sent = command
        self.joints = self.joints + PERIOD * command


def run(controller, plant, seconds, order=lambda _: HERE, force=lambda _: np.zeros(3)):
    """Run a closed loop at 500 Hz with a frame every 26 ms; return ticks, and simulated tips from the start tip."""
    memory = start_controller(controller, plant.sample())
    memory = set_origin(controller, memory, plant.tip())
    start, ticks, tips = plant.tip(), [], []
    for number in range(round(seconds / PERIOD)):
        plant.force = force(number * PERIOD)
        tick = step(controller, memory, plant.sample(number % 13 == 0), order(number * PERIOD))
        memory = tick.memory
        ticks.append(tick)
        tips.append(plant.seen - start)
        plant.obey(tick.command)
    return ticks, np.array(tips)


def pull(time: float) -> np.ndarray:
    return np.array([0.15 * (1.0 - math.cos(0.8 * time)), 0.0, 0.0])


@pytest.fixture(scope="module")
def pulled(paper_robot):
    """Return ticks and tips of the default controller under a varying load."""
    return run(controller(paper_robot), Plant(paper_robot), 4.0, force=pull)


def test_dual_layer_control_keeps_the_tip_in_place_under_a_varying_load(pulled):
    """The load deflects the uncontrolled tip by 9 mm; the error that remains is the lag of the rate filter."""
    assert np.abs(pulled[1]).max() < 2.5e-4


@pytest.mark.parametrize(
    ("inner", "observes"),
    [("type_1", False), ("type_1", True), ("type_1_exact", False), ("type_1_exact", True), ("type_2", False)],
)
def test_every_inner_loop_keeps_the_tip_in_place_under_a_varying_load(paper_robot, inner, observes):
    """The load rises fastest after 2 s, and the run ends half a second later."""
    _, tips = run(controller(paper_robot, inner=inner, observes=observes), Plant(paper_robot), 2.5, force=pull)

    assert np.abs(tips).max() < 2.5e-4


def test_differentiated_tracker_frames_keep_the_tip_in_place_under_a_varying_load(paper_robot):
    """Tracker frames have no noise here; the error that remains is the tip's motion within one and a half frames."""
    unit = replace(controller(paper_robot, observes=False), differentiates=True)
    _, tips = run(unit, Plant(paper_robot), 2.5, force=pull)

    assert np.abs(tips).max() < 5e-4


def test_uncompensated_tip_moves_under_a_varying_load(paper_robot):
    _, tips = run(controller(paper_robot, "unloaded_jacobian"), Plant(paper_robot), 4.0, force=pull)

    assert np.abs(tips).max() > 5e-3


def test_tip_with_a_stiffness_gives_way_by_force_over_stiffness_and_returns(paper_robot):
    stiffness = (20.0, 40.0, 300.0)
    unit = replace(controller(paper_robot), stiffness=TipStiffness(stiffness))
    push = np.array([0.1, 0.1, 0.0])
    ticks, tips = run(unit, Plant(paper_robot), 24.0, force=lambda time: push if time < 12.0 else np.zeros(3))

    np.testing.assert_allclose(tips[5999], push / stiffness, atol=1e-4)
    np.testing.assert_allclose(tips[-1], 0.0, atol=1e-4)
    assert max(np.linalg.norm(tick.memory.offset.position) for tick in ticks) < 0.006


def test_tip_gives_way_along_its_own_axis_by_force_over_stiffness(paper_robot):
    """The exact rod has its own frame of the tip, 32 deg from the world's z here."""
    stiffness, plant = (60.0, 40.0, 400.0), Plant(paper_robot)
    unit = replace(controller(paper_robot), stiffness=TipStiffness(stiffness, frame="tip"))
    axis = plant.rod.solve(plant.joints, np.zeros(6)).rotation[:, 2]
    assert axis[2] < 0.86
    _, tips = run(unit, plant, 6.0, force=lambda _: 0.3 * axis)

    turned = plant.rod.solve(plant.joints, np.r_[plant.force, np.zeros(3)]).rotation
    np.testing.assert_allclose(
        tips[-1], turned @ np.diag(1.0 / np.array(stiffness)) @ turned.T @ plant.force, atol=2e-5
    )
    assert tips[-1] @ axis == pytest.approx(0.3 / 400.0, rel=0.02)


def test_stiffness_of_a_setpoint_replaces_that_of_the_controller(paper_robot):
    unit = replace(controller(paper_robot), stiffness=TipStiffness((20.0, 20.0, 200.0)))
    order = HERE._replace(stiffness=TipStiffness((40.0, 40.0, 200.0)))
    ticks, tips = run(unit, Plant(paper_robot), 8.0, lambda _: order, force=lambda _: np.array([0.1, 0.0, 0.0]))

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
    _, tips = run(unit, Plant(paper_robot), 2.0, lambda _: Setpoint(np.array([0.0, 0.0, 1e-3]), np.zeros(3)))

    times = PERIOD * np.arange(len(tips))
    np.testing.assert_allclose(tips[:, 2], 1e-3 * (1.0 - np.exp(-k * times)), rtol=0, atol=2e-5)
    np.testing.assert_allclose(tips[:, :2], 0.0, atol=2e-5)


def test_tip_follows_a_ramp_with_feedforward_without_lag_despite_delayed_commands(paper_robot):
    late = 10
    unit, plant = controller(paper_robot, lag=late * PERIOD), Plant(paper_robot)
    memory = set_origin(unit, start_controller(unit, plant.sample()), plant.tip())
    start, waiting, slope, error = plant.tip(), [np.zeros(3)] * late, np.array([0.0, 1e-3, 3e-3]), np.zeros(3)
    for number in range(1000):
        time = number * PERIOD
        tick = step(unit, memory, plant.sample(number % 13 == 0), Setpoint(time * slope, slope))
        memory = tick.memory
        error = plant.tip() - start - time * slope
        waiting.append(tick.command)
        plant.joints = plant.joints + PERIOD * waiting.pop(0)
        plant.sent = tick.command

    np.testing.assert_allclose(error, 0.0, atol=1e-5)  # a tip that lags by 20 ms would be 60 um behind


def test_delta_1_and_delta_2_add_up_to_the_whole_deflection(paper_robot):
    ticks, _ = run(
        controller(paper_robot), Plant(paper_robot), 3.0,
        lambda time: Setpoint(np.array([0.0, 0.0, 3e-3 * time]), np.array([0.0, 0.0, 3e-3])), pull,
    )  # fmt: skip
    now = ticks[-1].memory.estimate

    assert np.abs(now.known.delta_2).max() > 1e-4
    np.testing.assert_allclose(now.known.delta_1 + now.known.delta_2, now.known.deflection, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(now.known.deflection, now.loaded.tip - now.unloaded.tip)


def test_exact_and_filtered_deflection_rates_match_the_derivative_of_the_deflection(pulled):
    known = [tick.memory.estimate.known for tick in pulled[0]]
    middle = 1470
    true = (known[middle + 20].deflection - known[middle - 20].deflection) / (40 * PERIOD)

    np.testing.assert_allclose(known[middle].deflection_rate_raw, true, rtol=0, atol=2e-5)
    # Both rates pass through the 5 Hz filter, which delays them by 45 ms.
    np.testing.assert_allclose(known[middle].deflection_rate, true, rtol=0, atol=2e-4)
    np.testing.assert_allclose(known[middle].deflection_rate_exact, true, rtol=0, atol=2e-4)


def test_observed_velocity_matches_the_tip_and_delta_is_its_difference_from_u_int(pulled):
    ticks, tips = (part[:1500] for part in pulled)
    true = (tips[-1] - tips[-41]) / (40 * PERIOD)

    np.testing.assert_allclose(ticks[-20].memory.estimate.known.velocity_observed, true, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(ticks[-1].delta, ticks[-1].memory.estimate.known.velocity_observed - ticks[-1].u_int)


def test_measured_tip_is_constant_between_tracker_frames_while_the_observed_tip_moves(paper_robot):
    unit, plant = controller(paper_robot), Plant(paper_robot)
    memory = start_controller(unit, plant.sample())
    first = plant.tip()
    for _ in range(10):
        plant.obey(np.array([0.0, 0.0, 0.01]))
        memory = step(unit, memory, plant.sample(frame=False), HERE).memory

    assert memory.tip.tolist() == first.tolist()
    np.testing.assert_allclose(memory.estimate.observed.tip, plant.tip(), rtol=0, atol=1e-5)
    assert np.linalg.norm(plant.tip() - first) > 1e-4


def test_controller_tick_gives_equal_results_for_equal_inputs(paper_robot):
    unit, plant = controller(paper_robot), Plant(paper_robot)
    memory = start_controller(unit, plant.sample())
    plant.force = np.array([0.1, 0.0, 0.0])
    sample = plant.sample()

    first, second = (step(unit, memory, sample, HERE) for _ in range(2))

    np.testing.assert_array_equal(first.command, second.command)
    np.testing.assert_array_equal(first.memory.estimate.observed.covariance, second.memory.estimate.observed.covariance)
    assert first.command.any()


def test_controller_tick_without_an_order_sends_zero_velocity_and_updates_the_estimates(paper_robot):
    unit, plant = controller(paper_robot), Plant(paper_robot)
    memory = start_controller(unit, plant.sample())
    plant.force = np.array([0.2, 0.0, 0.0])

    tick = step(unit, memory, plant.sample(), None)

    assert not tick.command.any()
    assert tick.memory.estimate.known.deflection[0] > 5e-3
    assert (tick.memory.origin + tick.setpoint.position).tolist() == tick.memory.tip.tolist()


def test_commanded_joint_motion_is_executed_within_the_joint_limits(paper_robot):
    unit, plant = controller(paper_robot), Plant(paper_robot, np.array([0.0, math.pi / 2, -0.0051]))
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
    plant = Plant(paper_robot)
    tip = plant.tip()
    face = float(tip[2]) + 2e-3
    unit = controller(paper_robot, others=(Workspace((-1.0, -1.0, 0.0), (1.0, 1.0, face)),))

    ticks, tips = run(unit, plant, 3.0, lambda _: Setpoint(np.array([0.0, 0.0, 5e-3]), np.zeros(3)))

    assert tips[:, 2].max() <= 2e-3 + 1e-5
    assert tips[-1, 2] == pytest.approx(2e-3, abs=2e-5)
    assert f"workspace z <= {face:g} m" in unit.limits.active(plant.joints, ticks[-1].at_bound, ticks[-1].at_row)


def test_workspace_stops_a_joint_motion_whose_joints_are_far_from_their_ends(paper_robot):
    plant = Plant(paper_robot)
    face = float(plant.tip()[2]) + 4e-3
    unit = controller(paper_robot, others=(Workspace((-1.0, -1.0, 0.0), (1.0, 1.0, face)),))
    memory, active = start_controller(unit, plant.sample()), False
    for _ in range(4000):
        tick = step(unit, memory, plant.sample(), JointMotion(np.array([0.0, 0.0, 0.002])))
        memory, active = tick.memory, active or bool(tick.at_row.any())
        plant.obey(tick.command)
    tip = plant.tip()
    assert active
    assert face - 1e-3 < tip[2] < face + 0.1e-3  # without the limit the tip moves by 16 mm


@pytest.mark.parametrize("what", ["joints", "sent", "wrenches", "tip"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_controller_tick_with_a_measurement_that_is_not_finite_is_refused(paper_robot, what, bad):
    unit, plant = controller(paper_robot), Plant(paper_robot)
    memory = start_controller(unit, plant.sample())
    sample = plant.sample()
    getattr(sample, what)[...] = bad

    with pytest.raises(CtrError):
        step(unit, memory, sample, HERE)


def test_controller_tick_with_a_setpoint_that_is_not_finite_is_refused(paper_robot):
    unit, plant = controller(paper_robot), Plant(paper_robot)
    memory = start_controller(unit, plant.sample())

    with pytest.raises(NotFinite):
        step(unit, memory, plant.sample(), Setpoint(np.array([math.nan, 0.0, 0.0]), np.zeros(3)))


@pytest.mark.parametrize("tip", [None, np.array([0.0, math.nan, 0.3])])
def test_controller_does_not_start_without_a_finite_tracker_frame(paper_robot, tip):
    with pytest.raises(NotFinite, match="tracker frame is needed"):
        start_controller(controller(paper_robot), Plant(paper_robot).sample()._replace(tip=tip))


@pytest.mark.parametrize("observes", [False, True])
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("inner", INNER_LOOPS)
def test_custom_loops_receive_the_same_inputs_as_built_in_loops(paper_robot, inner, exact, observes):
    usual = controller(paper_robot, "dual_layer", inner, observes, lag=0.012, exact=exact)
    own = replace(usual, strategy=Strategy(usual.strategy.outer, lambda u, view: usual.strategy.inner(u, view)))
    assert own.strategy.laws is None
    plant = Plant(paper_robot)
    plant.force = np.array([0.1, 0.05, 0.0])
    memory = start_controller(usual, plant.sample())
    for _ in range(5):
        plant.force += np.array([0.01, 0.0, 0.0])
        memory = step(usual, memory, plant.sample(), HERE).memory
    order = Setpoint(np.array([1e-3, -2e-3, 3e-3]), np.array([2e-3, 0.0, 1e-3]))
    first, second = (step(each, memory, plant.sample(), order) for each in (usual, own))

    np.testing.assert_allclose(first.command, second.command, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(first.u_int, second.u_int, rtol=1e-12)
    np.testing.assert_allclose(first.sigma, second.sigma, rtol=1e-9)
