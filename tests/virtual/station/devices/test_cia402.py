"""Special features of CANopen drives in virtual time: emergencies, watchdog, objects and identities."""

import pytest

from station.devices.cia402.protocol import COMMAND, FAULT_BIT, HEARTBEAT, HOST_NODE, Frame, encode
from station.devices.interfaces import Condition, Severity
from station.lab.simulated_cia402 import DISABLED, SimulatedDrive
from station.lab.simulated_line import Faults, SimulatedLine
from tests.harness.stages_bench import StagesBench, swing

SPEEDS = [0.3, -0.3, 0.015]


@pytest.fixture
def bench(paper) -> StagesBench:
    return StagesBench(paper, "cia402").connect()


def units(bench: StagesBench) -> tuple[SimulatedDrive, ...]:
    assert isinstance(bench.simulated, SimulatedLine)
    return bench.simulated.units


def fail(bench: StagesBench, slot: int, code: int) -> None:
    """Let a drive stop with an error, which it reports."""
    assert isinstance(bench.simulated, SimulatedLine)
    drive = units(bench)[slot - 1]
    for frame in drive.fail(code):
        bench.simulated.put(slot, frame, drive.motor.time)


def test_limits_ramps_and_reactions_are_written_to_every_drive(bench):
    assert [unit.values[0x607D, 1] for unit in units(bench)] == [-1_536_000, -1_536_000, 0]
    assert [unit.values[0x607D, 2] for unit in units(bench)] == [1_536_000, 1_536_000, 251_968]
    for unit in units(bench):
        assert unit.values[0x6083, 0] == unit.values[0x6084, 0] == unit.values[0x6085, 0] > 0
        assert (unit.values[0x605A, 0], unit.values[0x6007, 0]) == (6, 3)
        assert unit.values[0x1016, 1] == HOST_NODE << 16 | 100  # milliseconds without a heartbeat


def test_emergency_is_a_fault_with_its_meaning_that_stops_the_other_axes(bench):
    code, meaning = 0x4210, "the drive is too hot (error 0x4210)"
    bench.run(0.5, lambda now: SPEEDS)
    start = bench.now
    fail(bench, 2, code)
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


@pytest.mark.parametrize("cause", ["enable input", "another program", "fault that heals"])
def test_drive_that_is_switched_off_is_named_at_once_and_is_enabled_by_connecting_again(bench, cause):
    bench.run(0.5, lambda now: SPEEDS)
    drive, start = units(bench)[1], bench.now
    match cause:
        case "another program":
            bench.simulated.receive(encode(Frame(COMMAND + drive.node, bytes(6))), bench.now)
        case "fault that heals":
            drive.fail(0x3220)
            drive.state = DISABLED
        case _:
            drive.motor.stop()
            drive.state = DISABLED
    bench.run(1.0, lambda now: SPEEDS, until=lambda: bench.stages.condition is Condition.FAULT)
    assert bench.now - start <= 0.02
    assert bench.cause.startswith("the stage inner_rotation was switched off and receives no velocities")
    assert "check its enable input, its supply and other programs on the bus, then connect again" in bench.cause
    assert bench.run(0.5).speeds().tolist() == [0.0, 0.0, 0.0]
    bench.connect().run(0.5, lambda now: SPEEDS)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert (bench.speeds() > 0.0).all()


def test_fault_of_a_drive_is_acknowledged_by_connecting_again(bench):
    bench.run(0.5, swing)
    fail(bench, 1, 0x3220)
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


def test_drives_stop_within_a_tenth_of_a_second_and_the_braking_time_with_another_heartbeat_on_the_bus(bench):
    bench.run(1.0, lambda now: SPEEDS)
    for _ in range(150):  # the heartbeat of another node does not replace that of the host
        bench.simulated.receive(encode(Frame(HEARTBEAT + 4, b"\x05")), bench.now)
        bench.let_pass()
    before = bench.positions
    bench.let_pass(0.02)
    assert bench.positions.tolist() == before.tolist()


def test_stop_precedes_the_velocities_of_its_tick(bench):
    bench.run(1.0, lambda now: SPEEDS)
    written: list[bytes] = []
    bench.host.device.read()
    bench.stages.stop(bench.now)
    written.append(bench.host.device.read())
    assert written[0].startswith(b"t20160B00")  # controlword 0x000B: quick stop
