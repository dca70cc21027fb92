"""Lost stages: the other stages are stopped, the possible travel of the lost stages is reported, and recovery."""

import numpy as np
import pytest

from station.devices.interfaces import Condition
from station.devices.zaber.protocol import ZaberCommand, ZaberMessage
from station.lab.simulated_line import Faults
from tests.harness.zaber_bench import Bench, connected, swing


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

    def test_readings_of_an_unexpectedly_reset_unit_are_rejected(self, bench):
        bench.units[0].execute(ZaberMessage(1, 0, 0))
        bench.units[0].deaf_until = 0.0  # the unit answers again immediately after its reset
        bench.run(1.0, lambda now: [0.0, 0.0, 0.0])

        assert bench.stages.condition is Condition.FAULT
        assert "outer_rotation" in bench.stages.problem
        assert "does not move as commanded" in bench.stages.problem
        assert not bench.stages.axes.homed[0]

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

    def test_same_units_reconnect_on_another_port_and_need_homing(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.010])
        bench.near[0].close()
        bench.run(0.1)
        assert bench.stages.condition is Condition.FAULT
        bench.run(20.0)  # the stages continue to the limits of their travel

        bench.stages.connect(bench.now, bench.plug())
        bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert bench.stages.axes.homed == [False, False, False]
        bench.home()
        assert bench.stages.ready, bench.stages.problem

    def test_reconnected_stages_that_ran_on_are_stopped_at_once(self, bench):
        bench.run(1.0, lambda now: [0.1, 0.1, 0.001])
        bench.near[0].close()
        bench.run(2.0)
        assert bench.moving == [True, True, True]

        bench.stages.connect(bench.now, bench.plug())
        bench.run(0.2)
        assert bench.moving == [False, False, False]
        bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert bench.moving == [False, False, False]

    def test_units_that_move_when_the_station_starts_are_stopped_before_they_are_connected(self, paper):
        bench = Bench(paper, homed=False)
        for unit in bench.units:
            unit.execute(ZaberMessage(unit.number, ZaberCommand.MOVE_SPEED, 100))
        bench.run(0.1)
        assert bench.moving == [True, True, True]

        bench.stages.connect(bench.now)
        bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert bench.moving == [False, False, False]

    def test_slow_replies_within_the_deadline_lose_no_stage(self, bench):
        bench.chain.faults = Faults(delay=0.025)
        bench.run(3.0, swing)
        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
