"""Lost stages: the other stages are stopped, the possible travel of the lost stages is reported, and recovery."""

from dataclasses import replace

import numpy as np
import pytest

from station.devices.zaber.protocol import ZaberMessage
from station.devices.zaber.stages import Condition
from station.lab.simulated_zaber import Faults
from tests.harness.zaber_bench import LINEAR, Bench, connected, swing


@pytest.fixture
def bench(paper) -> Bench:
    return connected(paper)


class TestLosing:
    """A stage at constant speed has no watchdog: reachable stages are stopped, and unreachable stages are named."""

    def test_cut_chain_stops_reachable_stages_and_reports_the_range_of_the_others(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.010])
        bench.chain.faults = Faults(cut=3)
        cut = bench.now
        bench.run(2.0, lambda now: [0.1, 0.1, 0.010], until=lambda: bench.stages.condition is Condition.FAULT)
        assert bench.now - cut < 0.3
        bench.run(0.5)

        assert bench.moving == [False, False, True]
        problem = bench.stages.problem
        assert "the stage inner_translation cannot be reached" in problem
        assert "it can run on to -5.0 mm" in problem
        assert "outer_rotation" not in problem
        assert not bench.stages.ready
        bench.run(15.0)
        assert bench.truth[2] == pytest.approx(-0.005, abs=1e-6)  # the lost stage has moved to this limit

    def test_lost_stage_that_receives_again_is_stopped(self, bench):
        bench.run(1.0, lambda now: [0.0, 0.0, 0.010])
        bench.chain.faults = Faults(cut=3)
        bench.run(1.0)
        assert bench.moving == [False, False, True]
        bench.chain.faults = Faults()
        bench.run(1.0)

        assert bench.moving == [False, False, False]
        assert bench.stages.condition is Condition.FAULT

    @pytest.mark.parametrize("seed", range(4))
    def test_no_stage_continues_on_a_line_that_loses_bytes(self, paper, seed):
        bench = Bench(paper, seed=seed).connect()
        bench.chain.faults = Faults(drop=2e-3)
        bench.run(20.0, swing, until=lambda: bench.stages.condition is Condition.FAULT)
        bench.stages.stop(bench.now)
        bench.chain.faults = Faults()
        bench.run(2.0)

        assert bench.moving == [False, False, False]

    def test_readings_of_an_unexpectedly_reset_unit_are_rejected(self, bench):
        bench.units[0].execute(ZaberMessage(1, 0, 0))
        bench.units[0].deaf_until = 0.0  # the unit answers again immediately after its reset
        bench.run(1.0, lambda now: [0.0, 0.0, 0.0])

        assert bench.stages.condition is Condition.FAULT
        assert "outer_rotation" in bench.stages.problem
        assert "does not move as commanded" in bench.stages.problem
        assert not bench.stages.homed[0]

    def test_unplugged_adapter_loses_all_its_stages_without_an_exception(self, paper):
        bench = Bench(paper, apart=True).connect()
        bench.run(1.0, lambda now: [0.1, -0.1, 0.010])
        bench.near[1].close()
        bench.run(0.5, lambda now: [0.1, -0.1, 0.010])

        assert bench.stages.condition is Condition.FAULT
        assert "the stage inner_rotation cannot be reached" in bench.stages.problem
        assert "it can run on to -360.0 deg" in bench.stages.problem
        assert bench.moving == [False, True, False]
        assert np.isfinite(bench.reading.positions).all()

    def test_mute_unit_that_still_receives_is_stopped(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.010])
        bench.chain.faults = Faults(mute=frozenset({1}))
        bench.run(1.0, lambda now: [0.1, 0.1, 0.010])

        assert bench.stages.condition is Condition.FAULT
        assert bench.moving == [False, False, False]

    def test_same_units_reconnect_on_another_port_and_need_homing(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.010])
        bench.near[0].close()
        bench.run(0.1)
        assert bench.stages.condition is Condition.FAULT
        bench.run(20.0)  # the stages continue to the limits of their travel

        bench.stages.connect(bench.now, bench.plug())
        bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert bench.stages.homed == [False, False, False]
        bench.home()
        assert bench.stages.ready, bench.stages.problem

    def test_stages_refuse_other_units_on_the_same_port(self, bench):
        bench.near[0].close()
        bench.run(0.1)
        bench.units[2].kind = replace(LINEAR, serial=5)
        bench.stages.connect(bench.now, bench.plug())
        bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)

        assert "serial number 5; 1001 is expected" in bench.stages.problem

    def test_slow_replies_within_the_deadline_lose_no_stage(self, bench):
        bench.chain.faults = Faults(delay=0.025)
        bench.run(3.0, swing)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem

    def test_power_loss_of_a_unit_is_detected(self, bench):
        bench.run(1.0, swing)
        bench.chain.power_cycle(1)
        bench.run(2.0, swing)

        assert bench.stages.condition is Condition.FAULT
        assert "outer_rotation" in bench.stages.problem

    def test_connecting_that_was_stopped_is_not_connected(self, paper):
        bench = Bench(paper)
        bench.stages.connect(0.0)
        bench.run(0.2)
        bench.stages.stop(bench.now)
        bench.run(0.2)
        assert bench.stages.condition is Condition.FAULT
        assert "stopped" in bench.stages.problem
