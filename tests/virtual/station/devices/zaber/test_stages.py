"""The Zaber driver on simulated units: connecting, moving, stopping."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import CtrError
from station.config.robots import load_robot
from station.devices.interfaces import Condition
from station.devices.kernel.stages import Port
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.protocol import ZaberError
from station.devices.zaber.setup import StageSetup
from station.devices.zaber.stages import zaber_stages
from station.lab.simulated_line import Faults
from station.lab.wires import HostPort
from tests.harness.zaber_bench import ROTARY, START, STEPS, Bench, connected, swing


@pytest.fixture
def bench(paper) -> Bench:
    return connected(paper)


SMALL_STEPS = load_robot("paper").joints[0].model_copy(update={"microstep": 1e-7})


class TestSetup:
    """Conversion of joints to microsteps."""

    @pytest.mark.parametrize(
        ("change", "part"),
        [
            ({"device": 255}, "device number 255 is outside 1 ... 254"),
            ({"joint": SMALL_STEPS}, "maximum position 125663706"),  # two turns
            ({"home_at": 7.0}, "home count 3247234 is outside 0 ... 3072000 microsteps"),
            ({"home_speed": 0.0}, "home speed of 0 units"),
        ],
    )
    def test_invalid_setup_is_refused_by_name(self, paper, change, part):
        with pytest.raises(ZaberError, match=part):
            replace(StageSetup.of(paper.joints[0], 1), **change)

    def test_ports_must_carry_every_stage_once(self, paper):
        setups = [StageSetup.of(joint, k + 1) for k, joint in enumerate(paper.joints)]
        host = HostPort("line")
        with pytest.raises(CtrError, match=r"\[0, 1\]"):
            zaber_stages(setups, [Port(host, (0, 1))])
        with pytest.raises(ZaberError, match="same device number"):
            zaber_stages([setups[0], replace(setups[1], device=1), setups[2]], [Port(host, (0, 1, 2))])


class TestConnecting:
    """Connection: identity, settings, positions."""

    def test_units_report_their_identity_and_receive_their_settings(self, bench):
        assert [tuple(identity) for identity in bench.stages.axes.identities] == [
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

    def test_unexpected_unit_is_refused(self, paper):
        bench = Bench(paper)
        bench.stages = zaber_stages([*bench.setups[:2], replace(bench.setups[2], serial=1002)], bench.ports)
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
        assert bench.stages.axes.homed == [False, True, True]

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

        bench.run(4.0, track)
        assert (worst < 2.0).all()

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


def test_deadlines_can_be_changed(paper):
    bench = Bench(paper)
    bench.stages = zaber_stages(bench.setups, bench.ports, LineSettings(deadline=0.2))
    bench.chain.faults = Faults(delay=0.150)
    bench.connect()
    assert bench.stages.condition is not Condition.FAULT, bench.stages.problem
