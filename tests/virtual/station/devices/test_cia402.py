"""What only CANopen drives do: emergencies, the watchdog, objects and identities, in virtual time."""

import pytest

from station.devices.cia402.protocol import FAULT_BIT, HEARTBEAT, HOST_NODE, Frame, encode
from station.devices.interfaces import Condition, Severity
from station.lab.simulated_cia402 import SimulatedDrive
from station.lab.simulated_zaber import Faults
from tests.harness.stages_bench import StagesBench, swing

SPEEDS = [0.3, -0.3, 0.015]


@pytest.fixture
def bench(paper) -> StagesBench:
    return StagesBench(paper, "cia402").connect()


def units(bench: StagesBench) -> list[SimulatedDrive]:
    return list(bench.simulated.units)


def test_limits_ramps_and_reactions_are_written_to_every_drive(bench):
    assert [unit.values[0x607D, 1] for unit in units(bench)] == [-1_536_000, -1_536_000, 0]
    assert [unit.values[0x607D, 2] for unit in units(bench)] == [1_536_000, 1_536_000, 251_968]
    for unit in units(bench):
        assert unit.values[0x6083, 0] == unit.values[0x6084, 0] == unit.values[0x6085, 0] > 0
        assert (unit.values[0x605A, 0], unit.values[0x6007, 0]) == (6, 3)
        assert unit.values[0x1016, 1] == HOST_NODE << 16 | 100  # milliseconds without a heartbeat


@pytest.mark.parametrize(
    ("code", "meaning"),
    [(0x2310, "the motor's current is too high (error 0x2310)"), (0x4210, "the drive is too hot (error 0x4210)")],
)
def test_emergency_is_a_fault_with_its_meaning_that_stops_the_other_axes(bench, code, meaning):
    bench.run(0.5, lambda now: SPEEDS)
    start = bench.now
    bench.simulated.fail(2, code)
    bench.run(1.0, lambda now: SPEEDS, until=lambda: bench.stages.condition is Condition.FAULT)
    assert bench.now - start <= 0.3
    fault = bench.stages.trouble(bench.now)
    assert fault is not None
    assert (fault.severity, fault.text) == (Severity.FAULT, f"the stage inner_rotation reports: {meaning}")
    assert fault.details == "inner_rotation: node 2 on cia402"
    bench.run(0.3)
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]


def test_state_fault_is_reported_although_the_emergency_is_lost(bench):
    bench.run(0.5, swing)
    units(bench)[0].fail(0x3220)
    bench.run(0.1, swing)
    assert bench.cause.startswith("the stage outer_rotation is in the state 'fault'")


def test_fault_of_a_drive_is_acknowledged_by_connecting_again(bench):
    bench.run(0.5, swing)
    bench.simulated.fail(1, 0x3220)
    bench.run(0.3, swing)
    assert bench.stages.condition is Condition.FAULT
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert not units(bench)[0].statusword & FAULT_BIT


def test_stall_is_a_fault(bench):
    bench.run(0.5, swing)
    bench.simulated.faults = Faults(stalled=frozenset({2}))
    bench.run(0.5, swing)
    assert "inner_rotation reports: the position does not follow its command (error 0x8611)" in bench.cause


def test_drives_stop_by_themselves_when_the_host_is_silent(bench):
    bench.run(1.0, lambda now: SPEEDS)
    # 100 ms without a heartbeat, of which the last is at most 24 ms old, then 172 ms of braking.
    for _ in range(150):
        bench.let_pass()
    before = bench.positions
    bench.let_pass(0.02)
    assert bench.positions.tolist() == before.tolist()


def test_drives_stop_within_a_tenth_of_a_second_and_the_braking_time_with_another_heartbeat_on_the_bus(bench):
    bench.run(1.0, lambda now: SPEEDS)
    for _ in range(150):  # the heartbeat of another node does not replace that of the host
        bench.simulated.receive(encode(Frame(HEARTBEAT + 4, b"\x05")), bench.now)
        bench.let_pass()
    before = bench.positions
    bench.let_pass(0.02)
    assert bench.positions.tolist() == before.tolist()


def test_missing_drive_is_named(paper):
    bench = StagesBench(paper, "cia402")
    units(bench)[1].node = 7
    assert "the stage inner_rotation does not answer; is it powered" in bench.connect().cause


def test_another_drive_on_a_known_node_is_refused(bench):
    units(bench)[2].serial += 1
    assert "inner_translation has serial number 3004; 3003 is expected" in bench.connect().cause


def test_stop_precedes_the_velocities_of_its_tick(bench):
    bench.run(1.0, lambda now: SPEEDS)
    written: list[bytes] = []
    bench.host.device.read()
    bench.stages.stop(bench.now)
    written.append(bench.host.device.read())
    assert written[0].startswith(b"t20160B00")  # controlword 0x000B: quick stop
