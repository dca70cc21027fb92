"""CANopen drives of several makes, simulated from facts of their object dictionaries, in virtual time."""

import numpy as np
import pytest

from core.errors import CtrError
from station.config.robots import RobotFile
from station.devices.cia402.makes import Make
from station.devices.cia402.protocol import SDO_REQUEST, FrameReader, text
from station.devices.cia402.sequences import GEAR_RATIO, MAX_DECELERATION, OPTIONAL
from station.devices.cia402.setup import DriveFile, DriveSetup
from station.devices.cia402.stages import cia402_stages
from station.devices.interfaces import Condition
from station.lab.simulated_cia402 import DriveVariant, SimulatedDrive, epos4, simulated_can_bus
from tests.harness.drive_dictionaries import DICTIONARIES
from tests.harness.stages_bench import START, StagesBench

#: Encoder counts per turn of the motors.
COUNTS = 4096.0
SPEEDS = np.array([0.3, -0.3, 0.015])


def bench_of(robot: RobotFile, variant: DriveVariant, make: Make = "epos4", homed: bool = True) -> StagesBench:
    """Return a bench with drives of a variant, and the driver of a make."""
    bench = StagesBench(robot, "cia402")
    places = [(q - s.home_at) / s.joint.microstep for q, s in zip(START, bench.setups, strict=True)]
    drives = [SimulatedDrive(s, at, homed, variant) for s, at in zip(bench.setups, places, strict=True)]
    bench.simulated = simulated_can_bus(drives, 0)
    counts = None if make == "generic" else COUNTS
    files = (DriveFile(node=s.device, make=make, counts_per_turn=counts) for s in bench.setups)
    pairs = zip(robot.joints, files, strict=True)
    bench.stages = cia402_stages([DriveSetup.of(joint, file) for joint, file in pairs], bench.host)
    return bench


def test_epos4_moves_brakes_and_homes_in_its_own_units(paper: RobotFile) -> None:
    bench = bench_of(paper, epos4(COUNTS), homed=False).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    bench.home()
    assert bench.stages.ready, bench.cause
    bench.run(0.5, lambda now: [0.0, 0.0, 0.0])
    before, start = bench.positions, bench.now
    bench.run(1.0, lambda now: SPEEDS.tolist())
    # At a constant acceleration a stage is behind full speed by half the time of its ramp.
    ramps = [0.5 * abs(v) / joint.acceleration for v, joint in zip(SPEEDS, paper.joints, strict=True)]
    assert bench.positions - before == pytest.approx(SPEEDS * (bench.now - start - np.array(ramps) - 0.002), rel=0.02)
    assert bench.reading.positions == pytest.approx(bench.positions, abs=1e-3)


def test_acceleration_of_epos4_is_in_turns_per_minute_and_second(paper: RobotFile) -> None:
    """1.75 rad/s^2 at 4.09 urad a count and 4096 counts a turn are 104.5 turns/s^2, so 6 268 units."""
    joint = paper.joints[0].model_copy(update={"microstep": 4.09e-6, "acceleration": 1.75})
    setup = DriveSetup.of(joint, DriveFile(node=1, make="epos4", counts_per_turn=COUNTS))
    assert setup.acceleration == pytest.approx(1.75 / 4.09e-6 / COUNTS * 60.0, abs=1.0)


def test_default_homing_methods_of_epos4_exist_and_others_are_named(paper: RobotFile) -> None:
    methods = epos4(COUNTS).methods
    for joint in paper.joints:
        assert DriveSetup.of(joint, DriveFile(node=1, make="epos4", counts_per_turn=COUNTS)).homing_method in methods
        with pytest.raises(CtrError, match=r"homing_method = 21: a drive of make 'epos4' has only -4, -3"):
            DriveSetup.of(joint, DriveFile(node=1, make="epos4", counts_per_turn=COUNTS, homing_method=21))


def test_drive_with_other_units_than_its_make_is_refused(paper: RobotFile) -> None:
    bench = bench_of(paper, DriveVariant(units={(0x60A9, 0): 0x00B44700}), "generic").connect()
    assert "its unit object 0x60A9:00 is 0x00B44700; for make 'generic' it must be 0x00B50300" in bench.cause


def test_drive_that_keeps_another_acceleration_is_refused(paper: RobotFile) -> None:
    bench = bench_of(paper, DriveVariant(kept={(0x6085, 0): 5}), "generic").connect()
    assert "keeps 5 in object 0x6085:00 instead of" in bench.cause


def test_adapter_that_writes_times_behind_its_frames_is_read(paper: RobotFile) -> None:
    bench = bench_of(paper, DriveVariant(), "generic")
    advance = bench.simulated.advance
    bench.simulated.advance = lambda now: advance(now).replace(b"\r", b"1A2B\r")
    bench.connect()
    assert bench.stages.ready, bench.cause


def test_times_that_an_adapter_keeps_without_power_are_switched_off(paper: RobotFile) -> None:
    bench, kept, received = bench_of(paper, DriveVariant(), "generic"), bytearray(b"Z1\r"), []
    advance, receive = bench.simulated.advance, bench.simulated.receive
    bench.simulated.receive = lambda data, now: (kept.extend(data), receive(data, now))[1]

    def stamped(now: float) -> bytes:
        last = max(kept.rfind(b"Z1\r"), kept.rfind(b"Z0\r"))
        data = advance(now)
        received.append(data)
        return data.replace(b"\r", b"1A2B\r") if kept[last : last + 2] == b"Z1" else data

    bench.simulated.advance = stamped
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert b"Z0\r" in kept


def faulhaber(counts_per_turn: float) -> DriveVariant:
    """Return a Faulhaber drive: turns per minute, and turns per second squared."""
    return DriveVariant(counts_per_turn / 60.0, counts_per_turn)


@pytest.mark.parametrize("make", DICTIONARIES)
def test_every_access_of_a_make_exists_in_its_dictionary_with_this_size(paper: RobotFile, make: Make) -> None:
    variant = {"epos4": epos4, "faulhaber": faulhaber}[make](COUNTS)
    bench = bench_of(paper, variant, make, homed=False)
    reader, seen, receive = FrameReader(), [], bench.simulated.receive

    def recorded(data: bytes, now: float) -> None:
        seen.extend(frame for frame in reader.feed(data) if frame.identifier >> 7 == SDO_REQUEST >> 7)
        receive(data, now)

    bench.simulated.receive = recorded
    bench.connect().home()
    assert bench.stages.ready, bench.cause
    (entries, complete), writes = DICTIONARIES[make], 0
    for frame in seen:
        command, entry = frame.data[0], (int.from_bytes(frame.data[1:3], "little"), frame.data[3])
        known = entries.get(entry)
        if known is None:  # the driver may try what it can do without
            assert not complete or entry in (*OPTIONAL, *GEAR_RATIO, MAX_DECELERATION), text(entry)
        elif command != 0x40:
            size, writes = 4 - (command >> 2 & 3), writes + 1
            assert known.writable, text(entry)
            assert size == known.size, text(entry)
            value = int.from_bytes(frame.data[4 : 4 + size], "little", signed=known.least < 0)
            assert known.least <= value <= known.most, f"{text(entry)} = {value}"
    assert writes > 50


def test_faulhaber_moves_and_brakes_in_its_own_units(paper: RobotFile) -> None:
    bench = bench_of(paper, faulhaber(COUNTS), "faulhaber").connect()
    assert bench.stages.ready, bench.cause
    bench.run(1.0, lambda now: SPEEDS.tolist())
    before = bench.positions
    bench.stages.stop(bench.now)
    bench.run(1.0)
    braking = np.array([v * abs(v) / (2.0 * j.acceleration) for v, j in zip(SPEEDS, paper.joints, strict=True)])
    # Accelerations are rounded up to a whole number of turns per second squared; STOP arrives within two cycles.
    distance = np.abs(bench.positions - before)
    assert (distance <= np.abs(braking) + np.abs(SPEEDS) * 0.008).all()
    assert (distance >= 0.8 * np.abs(braking)).all()


@pytest.mark.parametrize(
    ("entry", "make"), [((0x6080, 0), "epos4"), ((0x60C5, 0), "generic"), ((0x60C6, 0), "generic")]
)
def test_drive_that_limits_its_speed_or_acceleration_is_refused(
    paper: RobotFile, entry: tuple[int, int], make: Make
) -> None:
    usual = epos4(COUNTS) if make == "epos4" else DriveVariant()
    bench = bench_of(paper, usual._replace(units={**usual.units, entry: 1300}), make).connect()
    assert f"limits itself: {text(entry)} is 1300, but the joint needs" in bench.cause


def test_drive_that_scales_its_positions_by_a_gear_is_refused(paper: RobotFile) -> None:
    bench = bench_of(paper, DriveVariant(units={(0x6091, 1): 50, (0x6091, 2): 3}), "generic").connect()
    assert "has a gear ratio of 50 / 3 (0x6091); the driver uses encoder counts: set it to 1 / 1" in bench.cause
    assert bench_of(paper, DriveVariant(units={(0x6091, 1): 1, (0x6091, 2): 1}), "generic").connect().stages.ready


def test_reversed_drive_and_smooth_ramps_of_another_program_are_undone(paper: RobotFile) -> None:
    bench = bench_of(paper, DriveVariant(), "generic")
    drives = [drive for drive in bench.simulated.units if isinstance(drive, SimulatedDrive)]
    for drive in drives:
        drive.values |= {(0x607E, 0): 0xC0, (0x6086, 0): 1}
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert [drive.values[entry] for drive in drives for entry in ((0x607E, 0), (0x6086, 0))] == 6 * [0]


@pytest.mark.parametrize(
    ("sent", "received"),
    [
        pytest.param(b"z\r", b"\n", id="confirms by LF"),
        pytest.param(b"z\r", b"Z\r", id="confirms as for an extended frame"),
        pytest.param(b"z\r", b"z\rT18FEF10080102030405060708\rR18FEF1000\r", id="other devices on the bus"),
    ],
)
def test_adapter_that_confirms_otherwise_or_passes_other_frames_is_read(
    paper: RobotFile, sent: bytes, received: bytes
) -> None:
    bench = bench_of(paper, DriveVariant(), "generic")
    advance = bench.simulated.advance
    bench.simulated.advance = lambda now: advance(now).replace(sent, received)
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert {bench.stages.details()[joint.name]["lost_bytes"] for joint in paper.joints} == {0}
