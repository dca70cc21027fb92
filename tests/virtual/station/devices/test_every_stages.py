"""Contract of all stage drivers, checked on their simulated stages in virtual time: the same tests for every driver."""

import math
import re

import numpy as np
import pytest

from station.devices.interfaces import Condition, Severity
from station.lab.simulated_stages import STAGES
from station.lab.simulated_zaber import Faults
from tests.harness.stages_bench import START, StagesBench, swing

#: Speeds of the joints in the tests [rad/s, rad/s, m/s], within the limits of the robot `paper`.
SPEEDS = np.array([0.3, -0.3, 0.015])
#: Largest time from a command to its effect for each driver [s].
LATENCY = {"zaber": 0.034, "zaber_ascii": 0.018, "cia402": 0.025, "grbl": 0.016, "marlin": 0.016}


@pytest.fixture(params=list(STAGES))
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def bench(paper, kind) -> StagesBench:
    bench = StagesBench(paper, kind).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.stages.ready
    return bench


def test_positions_are_unknown_before_the_stages_answer(paper, kind):
    bench = StagesBench(paper, kind)
    assert np.isnan(bench.reading.positions).all()
    assert not bench.stages.ready


def test_connecting_moves_no_stage(paper, kind):
    bench = StagesBench(paper, kind).connect()
    assert bench.positions == pytest.approx(START, abs=1e-9)
    assert bench.run(0.1).reading.positions == pytest.approx(START, abs=1e-5)


def test_details_name_every_joint_with_its_state(bench, paper):
    details = bench.stages.details()
    assert {joint.name for joint in paper.joints} <= set(details)
    assert all(details[joint.name]["homed"] for joint in paper.joints)


def test_position_between_two_answers_follows_the_moving_stage(bench):
    bench.run(0.5, swing)
    worst = np.zeros(3)

    def track(now: float) -> list[float]:
        nonlocal worst
        worst = np.maximum(worst, np.abs(bench.reading.positions - bench.truth))
        return swing(now)

    bench.run(8.0, track)
    assert (worst < [1e-3, 1e-3, 5e-5]).all()


def test_stages_run_at_the_velocity_that_the_driver_reports_as_sent(bench):
    bench.run(1.0, lambda now: SPEEDS.tolist())
    assert bench.reading.sent == pytest.approx(SPEEDS, rel=2e-3)
    before, start = bench.positions, bench.now
    bench.run(1.0, lambda now: SPEEDS.tolist())
    assert (bench.positions - before) / (bench.now - start) == pytest.approx(bench.reading.sent, rel=1e-4)


def test_command_takes_effect_within_the_latency_of_its_driver(bench, kind):
    bench.run(0.5, lambda now: [0.0, 0.0, 0.0])
    start = bench.now
    bench.run(1.0, lambda now: SPEEDS.tolist(), until=lambda: bool((bench.positions != np.array(START)).all()))
    assert bench.now - start <= LATENCY[kind]


def test_speed_is_limited_to_that_of_the_joint(bench, paper):
    bench.run(1.0, lambda now: [5.0, -5.0, 5.0])
    assert (np.abs(bench.reading.sent) <= [joint.speed * (1.0 + 2e-3) for joint in paper.joints]).all()


def test_stop_brakes_every_stage_within_its_braking_time(bench, kind):
    bench.run(1.0, lambda now: SPEEDS.tolist())
    bench.stages.stop(bench.now)
    # The joints of the robot brake from these speeds within 0.172 s.
    bench.run(0.172 + LATENCY[kind] + 0.02)
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]
    assert bench.reading.sent.tolist() == [0.0, 0.0, 0.0]
    bench.run(0.3)
    assert bench.reading.positions == pytest.approx(bench.positions, abs=1e-5)


def test_stages_move_again_after_a_stop(bench):
    bench.run(0.5, lambda now: SPEEDS.tolist())
    bench.stages.stop(bench.now)
    bench.run(0.5)
    bench.run(0.5, lambda now: (-SPEEDS).tolist())
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert (bench.speeds() > 0.0).all()


def test_velocity_that_is_not_finite_stops_every_stage(bench):
    bench.run(1.0, lambda now: SPEEDS.tolist())
    bench.run(0.5, lambda now: [0.1, math.nan, 0.001])
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]


def test_hardware_limits_stop_a_stage_at_both_ends_of_its_travel(bench, paper):
    for sign, end in ((1.0, paper.joints[2].upper), (-1.0, paper.joints[2].lower)):
        bench.run(15.0, lambda now, sign=sign: [0.0, 0.0, sign * 0.02])
        assert bench.positions[2] == pytest.approx(end, abs=1e-5)
        assert bench.reading.positions[2] == pytest.approx(end, abs=1e-5)
        assert bench.stages.condition is Condition.CONNECTED, bench.cause


def test_stages_that_are_not_homed_ignore_velocities(paper, kind):
    bench = StagesBench(paper, kind, homed=False).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready
    bench.run(0.5, swing)
    assert bench.positions == pytest.approx(START, abs=1e-9)


@pytest.mark.parametrize("at", [START, (-1.2, 0.4, -0.02)])
def test_homing_finds_the_true_positions_and_returns_to_the_zero(paper, kind, at):
    bench = StagesBench(paper, kind, at, homed=False).connect().home()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.stages.ready
    bench.run(0.1)
    assert bench.positions == pytest.approx([0.0, 0.0, paper.joints[2].lower], abs=2e-5)
    assert bench.reading.positions == pytest.approx(bench.positions, abs=2e-5)
    bench.run(2.0, swing)
    assert bench.reading.positions == pytest.approx(bench.truth, abs=1e-3)


def test_stop_ends_homing_and_leaves_the_stages_connected(paper, kind):
    bench = StagesBench(paper, kind, homed=False).connect()
    bench.stages.home(bench.now)
    bench.run(1.0)
    assert (bench.speeds() > 0.0).any()
    bench.stages.stop(bench.now)
    bench.run(2.0)  # some stages end their homing only by a reset
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready


def test_homing_reports_its_progress(paper, kind):
    bench = StagesBench(paper, kind, homed=False).connect()
    bench.stages.home(bench.now)
    bench.run(1.0)
    progress = bench.stages.details()["homing"]
    assert (progress["joint"], progress["number"], progress["of"]) == ("inner_translation", 1, 3)
    assert 0.0 < progress["gone"] < progress["way"]


def test_lost_line_is_a_fault_that_names_the_line(bench, kind):
    bench.run(0.5, swing)
    bench.host.device.unplug()
    bench.run(0.1, swing)
    fault = bench.stages.trouble(bench.now)
    assert bench.stages.condition is Condition.FAULT
    assert fault is not None
    assert fault.severity is Severity.FAULT
    assert "cannot be reached" in fault.text
    assert kind in fault.details


def test_fault_of_a_lost_line_states_whether_the_stages_brake_by_themselves(bench, kind):
    bench.run(0.5, lambda now: SPEEDS.tolist())
    bench.host.device.unplug()
    bench.run(0.02)
    brakes = re.search(r"it brakes by itself within ([\d.]+) s", bench.cause)
    assert (brakes is None) is kind.startswith("zaber")
    if brakes is None:
        assert re.search(r"last seen at \S+ deg, it can run on to 360.0 deg, \S+ deg away", bench.cause)
        assert (bench.run(1.0).speeds() > 0.9 * np.abs(SPEEDS)).all()
    else:  # 0.3 s: time for the braking itself
        assert bench.run(float(brakes[1]) + 0.3).speeds().tolist() == [0.0, 0.0, 0.0]


def test_silent_stage_is_a_fault_that_names_it_and_stops_the_others(bench):
    bench.run(0.5, lambda now: SPEEDS.tolist())
    bench.simulated.faults = Faults(cut=3)
    bench.run(1.0, lambda now: SPEEDS.tolist())
    assert bench.stages.condition is Condition.FAULT
    assert "inner_translation" in bench.cause
    assert bench.speeds()[:2].tolist() == [0.0, 0.0]


def test_stage_that_is_switched_off_and_on_must_be_homed_again(bench):
    bench.run(0.5, swing)
    bench.simulated.power_cycle(2)
    bench.run(2.0, swing)
    assert bench.stages.condition is Condition.FAULT
    assert "inner_rotation" in bench.cause
    bench.connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready


def test_connecting_after_a_fault_moves_no_stage(bench):
    bench.run(0.5, lambda now: SPEEDS.tolist())
    bench.simulated.faults = Faults(mute=frozenset({1, 2, 3}))
    bench.run(1.0, lambda now: SPEEDS.tolist())
    assert bench.stages.condition is Condition.FAULT
    bench.simulated.faults = Faults()
    bench.run(1.0)
    before = bench.positions
    bench.connect()
    bench.run(1.0)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.positions.tolist() == before.tolist()


def test_damaged_bytes_give_no_wrong_position(paper, kind):
    bench = StagesBench(paper, kind, seed=1).connect()
    bench.simulated.faults = Faults(flip=3e-4, drop=3e-4)
    worst = np.zeros(3)

    def track(now: float) -> list[float]:
        nonlocal worst
        worst = np.maximum(worst, np.abs(bench.reading.positions - bench.truth))
        return swing(now)

    bench.run(5.0, track)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert (worst < [0.02, 0.02, 0.001]).all()
