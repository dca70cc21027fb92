"""Contract of all stage drivers, checked on their simulated stages in virtual time: the same tests for every driver.

The drivers are those of the registry; a driver without simulated stages or without a latency fails.
"""

import math
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from core.errors import CtrError
from station.config.robots import RobotFile
from station.devices.interfaces import Condition, NotStopped, Severity
from station.devices.registry import STAGES_DRIVERS
from station.lab.simulated_line import Faults
from station.lab.simulated_stages import STAGES
from tests.harness.emergency import StoppingProcess, next_session
from tests.harness.stages_bench import KINDS, START, StagesBench, swing
from tests.tools.boots import boot, ways

#: Speeds of the joints in the tests [rad/s, rad/s, m/s], within the limits of the robot `paper`.
SPEEDS = np.array([0.3, -0.3, 0.015])
#: Largest time from a command to its effect for each driver [s].
LATENCY = {"zaber": 0.034, "zaber_ascii": 0.018, "cia402": 0.025, "imaginary": 0.018, "grbl": 0.016, "marlin": 0.016}
#: Kinds of simulated stages of the drivers that support several kinds.
DIALECTS = {"gcode": ("grbl", "marlin")}
#: Bytes that no stage sends, in each tick.
BABBLE: dict[str, Callable[[int], bytes]] = {
    "text of another device": lambda tick: b"" if tick % 50 else b"$GPGGA,12\r\n",
    "another baud rate": lambda tick: np.random.default_rng(tick).bytes(2),
    "no end of a line": lambda tick: b"" if tick % 50 else b"\x00",
}


@pytest.fixture(params=list(KINDS))
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def bench(paper, kind) -> StagesBench:
    bench = StagesBench(paper, kind).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.stages.ready
    return bench


def test_every_stage_driver_is_tested_here():
    tested = {kind for driver in STAGES_DRIVERS for kind in DIALECTS.get(driver, (driver,))}
    assert tested == set(STAGES)
    assert set(KINDS) == set(LATENCY)


def test_positions_are_unknown_before_the_stages_answer(paper, kind):
    bench = StagesBench(paper, kind)
    assert np.isnan(bench.reading.positions).all()
    assert not bench.stages.ready


def test_connecting_moves_no_stage(paper, kind):
    bench = StagesBench(paper, kind).connect()
    assert bench.positions == pytest.approx(START, abs=1e-9)
    assert bench.run(0.1).reading.positions == pytest.approx(START, abs=1e-5)


def test_stage_that_does_not_answer_is_named_when_connecting(paper, kind):
    bench = StagesBench(paper, kind)
    bench.simulated.faults = Faults(mute=frozenset({2}))
    bench.connect()
    assert bench.stages.condition is Condition.FAULT
    stage = "the board" if kind in DIALECTS["gcode"] else "the stage inner_rotation"
    assert f"{stage} does not answer; is it powered" in bench.cause


@pytest.mark.parametrize("babble", BABBLE)
def test_bytes_that_cannot_be_read_are_quoted_with_what_was_expected(paper, kind, babble):
    bench = StagesBench(paper, kind)
    bench.simulated.advance = lambda now: BABBLE[babble](int(now / 0.002))
    bench.connect()
    assert bench.stages.condition is Condition.FAULT
    assert "does not answer" not in bench.cause
    assert re.search(r"(the board|the stage outer_rotation) sends .+, expected .+; is it", bench.cause)


def test_echo_of_the_hosts_bytes_is_no_answer(paper, kind):
    bench, heard = StagesBench(paper, kind), bytearray()
    bench.simulated.receive = lambda data, now: heard.extend(data)
    bench.simulated.advance = lambda now: (bytes(heard), heard.clear())[0]
    bench.connect()
    assert re.search(r"(the board|the stage outer_rotation) sends .+, expected .+; is it", bench.cause)


@pytest.mark.parametrize("seconds", [0.3, 1.4, 2.6, 4.9, 9.0])
@pytest.mark.parametrize(("kind", "way"), [(kind, way) for kind in STAGES for way in ways(kind)])
def test_stages_that_start_late_connect_without_a_halt(paper, kind, way, seconds):
    found = boot(paper, kind, way, seconds)
    assert found.connected, found.cause
    assert not found.halted
    assert any("it may be starting (at most 10 s)" in word for word in found.words) == (seconds > 1.0)


def test_connecting_that_was_stopped_is_not_connected(paper, kind):
    bench = StagesBench(paper, kind)
    bench.stages.connect(bench.now)
    bench.run(0.02)
    bench.stages.stop(bench.now)
    bench.run(0.2)
    assert bench.stages.condition is Condition.FAULT
    assert "stopped while connecting" in bench.cause


def renumber(device, kind):
    """Give a device the serial number 5."""
    match kind:
        case "zaber":
            device.kind = replace(device.kind, serial=5)
        case "zaber_ascii":
            device._identity["system.serial"] = "5"
        case _:
            device.serial = 5


@pytest.mark.parametrize("kind", ["zaber", "zaber_ascii", "cia402"])
def test_two_devices_with_one_number_are_refused_with_both(bench, kind):
    device, before = bench.simulated.units[1], bench.stages.details()["inner_rotation"]["identity"]["serial"]
    renumber(twin := deepcopy(device), kind)
    receive = device.receive
    device.receive = lambda *command: [*receive(*command), *twin.receive(*command)]
    number = "node 2" if kind == "cia402" else "device 2"
    numbers = rf"serial number ({before} and 5|5 and {before}): give one of them another number"
    assert re.search(rf"two devices answer as {number}.*, with {numbers}", bench.connect().cause)


@pytest.mark.parametrize("kind", ["zaber", "zaber_ascii", "cia402", "imaginary"])
def test_another_device_than_before_is_refused(bench, kind):
    device, before = bench.simulated.units[2], bench.stages.details()["inner_translation"]["identity"]["serial"]
    renumber(device, kind)
    assert f"the stage inner_translation has serial number 5; {before} is expected" in bench.connect().cause


def test_details_name_every_joint_with_its_state(bench, paper):
    details = bench.stages.details()
    assert {joint.name for joint in paper.joints} <= set(details)
    assert all(details[joint.name]["homed"] for joint in paper.joints)


def test_position_between_two_answers_follows_the_moving_stage(bench):
    bench.run(0.5, swing)
    assert (bench.worst_errors(4.0, swing) < [1e-3, 1e-3, 5e-5]).all()


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


def test_hardware_limits_stop_a_stage_at_both_ends_of_its_travel(paper, kind):
    for sign, end in ((1.0, paper.joints[2].upper), (-1.0, paper.joints[2].lower)):
        bench = StagesBench(paper, kind, (0.0, math.pi / 2, end - sign * 0.01)).connect()
        bench.run(1.0, lambda now, sign=sign: [0.0, 0.0, sign * 0.02])
        assert bench.positions[2] == pytest.approx(end, abs=1e-5)
        assert bench.reading.positions[2] == pytest.approx(end, abs=1e-5)
        assert bench.stages.condition is Condition.CONNECTED, bench.cause


def test_stages_that_are_not_homed_ignore_velocities(paper, kind):
    bench = StagesBench(paper, kind, homed=False).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready
    bench.run(0.5, swing)
    assert bench.positions == pytest.approx(START, abs=1e-9)


@pytest.fixture
def faster(paper) -> RobotFile:
    """Return the robot `paper` with faster joints, so that homing takes fewer polls."""
    joints = tuple(joint.model_copy(update={"speed": 3.0 * joint.speed}) for joint in paper.joints)
    return paper.model_copy(update={"joints": joints})


def test_homing_needs_a_connection(paper, kind):
    with pytest.raises(CtrError, match="closed"):
        StagesBench(paper, kind).stages.home(0.0)


def test_homing_finds_the_true_positions_and_returns_to_the_zero(paper, faster, kind):
    bench = StagesBench(faster, kind, (-0.03, 0.1, -0.126), homed=False).connect().home()
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


def test_rotation_stopped_while_homing_still_finds_its_zero(faster, kind):
    bench = StagesBench(faster, kind, (-0.2, 0.01, -0.129), homed=False).connect()
    bench.stages.home(bench.now)
    moved = 0.1 if kind in DIALECTS["gcode"] else 3.8  # [rad]; more than half a turn where the stage turns back
    bench.run(100.0, until=lambda: abs(bench.positions[0] + 0.2) > moved)
    bench.stages.stop(bench.now)
    bench.run(3.0)
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]
    bench.home()
    assert bench.stages.ready, bench.cause
    assert bench.positions == pytest.approx([0.0, 0.0, -0.130], abs=2e-5)


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


def test_lost_stage_that_receives_again_is_stopped(bench):
    bench.run(1.0, lambda now: [0.0, 0.0, 0.010])
    bench.simulated.faults = Faults(cut=3)
    bench.run(1.0)
    bench.simulated.faults = Faults()
    bench.run(1.0)
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]
    assert bench.stages.condition is Condition.FAULT


@pytest.mark.parametrize("seed", range(2))
def test_no_stage_continues_on_a_line_that_loses_bytes(paper, kind, seed):
    bench = StagesBench(paper, kind, seed=seed).connect()
    bench.simulated.faults = Faults(drop=2e-3)
    bench.run(20.0, swing, until=lambda: bench.stages.condition is Condition.FAULT)
    bench.stages.stop(bench.now)
    bench.simulated.faults = Faults()
    bench.run(2.0)
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]


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
    worst = bench.worst_errors(5.0, swing)
    # Here a damaged controlword switches a CANopen drive off; a real bus has checksums.
    assert bench.stages.condition is Condition.CONNECTED or "was switched off" in bench.cause, bench.cause
    assert (worst < [0.02, 0.02, 0.001]).all()


@pytest.mark.parametrize("homing", [False, True])
def test_emergency_stop_of_another_process_stops_every_stage_and_keeps_its_homing(paper, kind, homing):
    bench = StagesBench(paper, kind, homed=not homing).connect()
    if homing:
        bench.stages.home(bench.now)
    bench.run(1.0, None if homing else lambda now: SPEEDS.tolist())
    bench.host.device.read()
    bench.host.write(b"G1 X")  # half a command of the dying process
    process, start = StoppingProcess(bench), bench.now
    assert "3 stages on port stop" in process.stop(paper, kind).replace("drives", "stages")
    process.sleep(1.0)
    assert process.last_motion - start <= (0.3 if homing else 0.172 + LATENCY[kind])
    next_session(bench, kind)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.stages.ready is not homing
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]


def test_emergency_stop_reports_stages_that_do_not_confirm(paper, kind):
    bench = StagesBench(paper, kind).connect()
    bench.simulated.faults = Faults(mute=frozenset({1, 2, 3}))
    with pytest.raises(NotStopped, match=r"(?s)not confirmed|do not answer.*press the emergency stop"):
        StoppingProcess(bench).stop(paper, kind)


@pytest.mark.parametrize("speed", [0.02, 0.3])
def test_position_of_every_axis_is_read_within_a_tenth_of_a_second(bench, speed):
    def readings() -> np.ndarray:
        return np.array([bench.stages.details()[s.joint.name]["readings"] for s in bench.setups])

    for _ in range(50):
        before = readings()
        bench.run(0.1, lambda now: (speed * math.cos(4.0 * now) * np.array([1.0, -1.0, 0.05])).tolist())
        assert (readings() > before).all()


@pytest.mark.parametrize("speed", [0.02, 0.3])
@pytest.mark.parametrize(("shape", "wait"), [("constant", 1.0), ("swing", 1.0), ("swing", 1.3), ("swing", 2.1)])
def test_axis_that_stands_still_is_named_within_a_second(bench, paper, speed, shape, wait):
    wanted = speed * np.array([1.0, -1.0, 0.05])

    def velocities(now: float) -> list[float]:
        return (wanted * (1.0 if shape == "constant" else math.cos(4.0 * now))).tolist()

    bench.run(wait, velocities)
    bench.simulated.faults = Faults(clamped=frozenset({2}))
    start = bench.now
    bench.run(3.0, velocities, until=lambda: bench.stages.condition is not Condition.CONNECTED)
    assert bench.stages.condition is Condition.FAULT
    assert f"the stage {paper.joints[1].name} does not move although it is commanded to" in bench.cause
    assert bench.now - start <= 1.0
