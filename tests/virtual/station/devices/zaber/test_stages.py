"""The Zaber driver on simulated units: connecting, moving, stopping."""

import math
from dataclasses import replace

import numpy as np
import pytest

from station.devices.zaber.chain import LineSettings
from station.devices.zaber.protocol import ZaberError
from station.devices.zaber.setup import PortSetup, StageSetup
from station.devices.zaber.stages import Condition, ZaberStages
from station.lab.simulated_zaber import Faults
from station.lab.wires import HostPort
from tests.harness.zaber_bench import ROTARY, START, STEPS, Bench, connected, swing


@pytest.fixture
def bench(paper) -> Bench:
    return connected(paper)


class TestSetup:
    """Conversion of joints to microsteps."""

    def test_setups_of_the_papers_stages_have_the_expected_numbers(self, paper):
        outer, inner, slide = (StageSetup.of(joint, k + 1) for k, joint in enumerate(paper.joints))

        assert (outer.home_count, outer.maximum) == (1_536_000, 3_072_000)  # one turn in both directions
        assert outer.top == inner.top == 9102  # 20 deg/s at 0.0021973 deg/s
        assert slide.top == 4300  # 20 mm/s at 4.6509 um/s
        assert outer.acceleration == 38  # 100 deg/s^2 at 2.637, rounded up
        assert slide.acceleration == 18  # 100 mm/s^2 at 5.581
        assert (slide.home_count, slide.maximum) == (0, 251_968)  # 125 mm
        assert slide.position(0) == -0.130
        assert slide.position(251_968) == pytest.approx(-0.005, abs=1e-6)
        assert inner.position(1_536_000) == 0.0
        assert inner.position(0) == pytest.approx(-2 * math.pi)

    @pytest.mark.parametrize(
        ("change", "part"),
        [
            ({"device": 255}, "device number 255 is outside 1 ... 254"),
            ({"maximum": 16_777_216}, "maximum position 16777216"),
            ({"home_count": -1}, "home count -1"),
            ({"home_speed": 0.0}, "home speed of 0 units"),
        ],
    )
    def test_invalid_setup_is_refused_by_name(self, paper, change, part):
        with pytest.raises(ZaberError, match=part):
            replace(StageSetup.of(paper.joints[0], 1), **change)

    def test_ports_must_carry_every_stage_once(self, paper):
        setups = [StageSetup.of(joint, k + 1) for k, joint in enumerate(paper.joints)]
        host = HostPort("line")
        with pytest.raises(ZaberError, match=r"\[0, 1\]"):
            ZaberStages(setups, [PortSetup(host, (0, 1))])
        with pytest.raises(ZaberError, match="same device number"):
            ZaberStages([setups[0], replace(setups[1], device=1), setups[2]], [PortSetup(host, (0, 1, 2))])


class TestConnecting:
    """Connection: identity, settings, positions."""

    def test_units_report_their_identity_and_receive_their_settings(self, bench):
        assert [tuple(identity) for identity in bench.stages.identities] == [
            (4421, 523, None),
            (4421, 523, None),
            (4332, 523, 1001),
        ]
        for unit, setup in zip(bench.units, bench.setups, strict=True):
            assert unit.settings[44] == setup.maximum
            assert unit.settings[43] == setup.acceleration
            assert unit.settings[37] == 64
            assert unit.settings[40] & 0b1001 == 0b1001  # automatic replies and the knob are disabled
            assert unit.settings[40] & 1 << 7  # the unit is still homed
            assert unit.settings[40] & 1 << 11  # settings of other programs are kept
        assert bench.stages.ready
        assert bench.reading.positions == pytest.approx(START, abs=1e-6)

    def test_units_that_are_not_homed_have_no_valid_position(self, paper):
        bench = Bench(paper, homed=False).connect()

        assert bench.stages.condition is Condition.CONNECTED
        assert bench.stages.homed == [False, False, False]
        assert not bench.stages.ready
        bench.run(0.5, swing)
        assert bench.truth == pytest.approx(START, abs=1e-9)  # stages that are not homed ignore velocity commands

    def test_position_is_unknown_before_the_first_answer(self, paper):
        bench = Bench(paper)
        assert np.isnan(bench.stages.poll(0.0).positions).all()

    def test_missing_unit_is_named(self, paper):
        bench = Bench(paper)
        bench.units[1].number = 7
        bench.connect()
        assert bench.stages.condition is Condition.FAULT
        assert "the stage inner_rotation does not answer" in bench.stages.problem

    def test_unexpected_unit_is_refused(self, paper):
        bench = Bench(paper)
        bench.stages = ZaberStages([*bench.setups[:2], replace(bench.setups[2], serial=1002)], bench.ports)
        bench.connect()
        assert "serial number 1001; 1002 is expected" in bench.stages.problem

    def test_unsupported_firmware_is_refused(self, paper):
        bench = Bench(paper)
        bench.units[0].kind = replace(ROTARY, firmware=601)
        bench.connect()
        assert "firmware 6.01" in bench.stages.problem

    def test_connect_resets_a_changed_resolution_and_invalidates_the_position(self, paper):
        bench = Bench(paper)
        bench.units[0].settings[37] = 128
        bench.connect()
        assert bench.units[0].settings[37] == 64
        assert bench.stages.homed == [False, True, True]

    def test_setting_that_is_not_accepted_is_named(self, paper):
        bench = Bench(paper)
        bench.units[2].settings[49] = 1  # 1: the unit's settings are locked
        bench.connect()
        assert bench.stages.condition is Condition.FAULT
        assert "inner_translation" in bench.stages.problem
        assert "settings are locked" in bench.stages.problem

    def test_stages_connect_on_a_noisy_line(self, paper):
        bench = Bench(paper)
        bench.chain.faults = Faults(drop=0.003, flip=0.003)
        bench.connect()
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert [unit.settings[44] for unit in bench.units] == [3_072_000, 3_072_000, 251_968]

    def test_message_ids_left_on_by_another_program_are_switched_off(self, paper):
        bench = Bench(paper)
        for unit in bench.units:
            unit.settings[40] |= 1 << 6
        bench.connect()
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert not any(unit.settings[40] & 1 << 6 for unit in bench.units)


class TestMoving:
    """The driver sends velocities and receives positions."""

    def test_positions_are_exact_to_a_microstep_between_the_polls(self, bench):
        worst = np.zeros(3)

        def track(now: float) -> list[float]:
            nonlocal worst
            worst = np.maximum(worst, np.abs(bench.reading.positions - bench.truth) / STEPS)
            return swing(now)

        bench.run(10.0, track)
        assert (worst < 2.0).all()

    def test_sent_velocities_match_the_velocities_of_the_units(self, bench):
        bench.run(3.0, lambda now: [math.radians(3.0), -0.1, 3.14e-3])

        assert bench.reading.sent == pytest.approx(
            [1365 * 9.375 * STEPS[0], -round(0.1 / (9.375 * STEPS[1])) * 9.375 * STEPS[1], 675 * 9.375 * STEPS[2]]
        )
        before, start = bench.places, bench.now
        bench.run(1.0, lambda now: [math.radians(3.0), -0.1, 3.14e-3])
        assert bench.places - before == pytest.approx(bench.reading.sent * (bench.now - start), rel=1e-6)

    def test_each_axis_gets_40_velocities_and_13_polls_a_second(self, bench):
        before = [(count.velocities, count.polls) for count in bench.stages.counts]
        bench.run(10.0, lambda now: np.array([1e-2, 2e-2, 1e-3]) * (1.0 + now))

        for (velocities, polls), count in zip(before, bench.stages.counts, strict=True):
            assert (count.velocities - velocities) / 10 == pytest.approx(40, abs=1.5)
            assert (count.polls - polls) / 10 == pytest.approx(40 / 3, abs=0.3)
            assert count.missed == count.rejected == 0

    def test_separate_lines_are_three_times_as_fast(self, paper):
        bench = Bench(paper, apart=True).connect()
        assert bench.stages.ready, bench.stages.problem
        before = [count.velocities for count in bench.stages.counts]
        bench.run(5.0, lambda now: [0.1 * math.sin(9 * now), 0.1 * math.cos(9 * now), 0.01 * math.sin(9 * now)])

        assert all((c.velocities - b) / 5 > 80 for c, b in zip(bench.stages.counts, before, strict=True))
        assert bench.reading.positions == pytest.approx(bench.truth, abs=1e-4)

    def test_stop_brakes_all_three_stages_at_once(self, bench):
        bench.run(1.0, lambda now: [0.3, -0.3, 0.02])
        bench.stages.stop(bench.now)
        bench.let_go()
        bench.run(6.25e-3 * 2)
        # After 12.5 ms all stages brake: no stage still has its earlier speed.
        assert [unit.status for unit in bench.units] == [23, 23, 23]
        bench.run(0.5)
        assert bench.moving == [False, False, False]
        assert bench.stages.at_rest
        assert bench.reading.sent.tolist() == [0.0, 0.0, 0.0]
        assert bench.reading.positions == pytest.approx(bench.truth, abs=2e-6)

    def test_nan_velocity_stops_the_stages(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.001])
        bench.run(0.5, lambda now: [0.1, math.nan, 0.001])

        assert bench.moving == [False, False, False]

    def test_hardware_maximum_position_stops_a_stage(self, bench):
        bench.run(15.0, lambda now: [0.0, 0.0, 0.02])

        assert bench.truth[2] == pytest.approx(-0.005, abs=1e-6)
        assert bench.reading.positions[2] == pytest.approx(-0.005, abs=1e-6)

    def test_noisy_line_loses_no_axis_and_gives_no_wrong_position(self, bench):
        bench.chain.faults = Faults(flip=1e-3)  # this rate corrupts about ten bytes
        worst = np.zeros(3)

        def track(now: float) -> list[float]:
            nonlocal worst
            worst = np.maximum(worst, np.abs(bench.reading.positions - bench.truth))
            return [0.1 * math.sin(now), 0.1 * math.cos(now), 0.005 * math.sin(now)]

        bench.run(5.0, track)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        # A velocity that was damaged in transit is detected at the next poll and repeated.
        assert (worst < [0.02, 0.02, 0.001]).all()
        assert sum(count.rejected + count.missed for count in bench.stages.counts) > 0


def test_deadlines_can_be_changed(paper):
    bench = Bench(paper)
    bench.stages = ZaberStages(bench.setups, bench.ports, LineSettings(deadline=0.2))
    bench.chain.faults = Faults(delay=0.150)
    bench.connect()
    assert bench.stages.condition is not Condition.FAULT, bench.stages.problem
