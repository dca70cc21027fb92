"""Special features of the ASCII driver in virtual time: warning flags, checksums and settings."""

import pytest

from station.devices.interfaces import Condition, Severity
from station.devices.zaber_ascii.sequences import OPTIONAL
from station.lab.simulated_line import Faults
from station.lab.simulated_zaber_ascii import AsciiUnit
from tests.harness.stages_bench import StagesBench, swing


@pytest.fixture
def bench(paper) -> StagesBench:
    return StagesBench(paper, "zaber_ascii").connect()


def units(bench: StagesBench) -> list[AsciiUnit]:
    return list(bench.simulated.units)


def test_settings_are_written_to_every_device(bench):
    assert [unit.settings["limit.min"] for unit in units(bench)] == [-1_536_000, -1_536_000, 0]
    assert [unit.settings["limit.max"] for unit in units(bench)] == [1_536_000, 1_536_000, 251_968]
    assert all(unit.settings["comm.checksum"] == 1 and unit.settings["knob.enable"] == 0 for unit in units(bench))


def test_stall_is_a_fault_with_the_makers_meaning(bench):
    bench.run(0.5, swing)
    bench.simulated.faults = Faults(stalled=frozenset({2}))
    bench.run(0.5, swing)
    fault = bench.stages.trouble(bench.now)
    assert fault is not None
    assert fault.severity is Severity.FAULT
    assert fault.text == "the stage inner_rotation reports: the motor stalled and has stopped (flag FS)"
    assert fault.details == "inner_rotation: device 2 axis 1 on zaber_ascii"
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]


def test_warning_flag_is_reported_and_the_stages_stay_connected(bench):
    units(bench)[0].flags.add("WT")
    bench.run(0.2, swing)
    fault = bench.stages.trouble(bench.now)
    assert fault is not None
    assert (fault.severity, bench.stages.condition) == (Severity.WARN, Condition.CONNECTED)
    assert fault.text == "the stage outer_rotation: the controller is hot (flag WT)"


@pytest.mark.parametrize(("flag", "severity"), [("WL", Severity.WARN), ("FF", Severity.FAULT)])
def test_flag_of_a_device_that_sends_alerts_without_a_request_is_reported(bench, flag, severity):
    for unit in units(bench):
        unit.settings["comm.alert"] = 1
    bench.run(0.5, swing)
    units(bench)[0].flags.add(flag)
    bench.run(0.2, swing)
    assert (fault := bench.stages.trouble(bench.now)) is not None
    assert (fault.severity, f"(flag {flag})" in fault.text) == (severity, True)


def test_stage_brakes_as_the_robots_file_states_although_another_program_has_set_its_deceleration(paper):
    bench = StagesBench(paper, "zaber_ascii")
    for unit in units(bench):
        unit.settings |= {"motion.decelonly": 5, "motion.accel.ramptime": 300}
    bench.connect().run(1.0, lambda now: [0.3, -0.3, 0.015])
    bench.stages.stop(bench.now)
    bench.run(0.21)  # braking takes up to 0.172 s
    assert bench.speeds().tolist() == [0.0, 0.0, 0.0]
    assert {unit.settings["motion.accel.ramptime"] for unit in units(bench)} == {0}


def test_firmware_without_separate_settings_of_the_ramps_connects(paper):
    bench = StagesBench(paper, "zaber_ascii")
    for unit in units(bench):
        for name in OPTIONAL:
            del unit.settings[name]
        unit._ramp = lambda name: None
    assert bench.connect().stages.ready, bench.cause


def test_other_microstep_resolution_is_refused(paper):
    bench = StagesBench(paper, "zaber_ascii")
    units(bench)[1].settings["resolution"] = 128
    assert "has 128 microsteps per step; 64 is expected" in bench.connect().cause


def test_driver_without_current_is_enabled_when_connecting(paper):
    bench = StagesBench(paper, "zaber_ascii")
    units(bench)[0].flags.add("FO")
    bench.connect()
    assert bench.stages.ready, bench.cause


def test_each_axis_gets_over_hundred_velocities_a_second(bench):
    before = bench.stages.details()["outer_rotation"]["velocities"]
    bench.run(4.0, swing)
    assert (bench.stages.details()["outer_rotation"]["velocities"] - before) / 4.0 > 100.0
