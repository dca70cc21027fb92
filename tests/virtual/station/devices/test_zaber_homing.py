"""Homing of simulated stages: order, direction, stops, and stages that cannot home."""

import math

import pytest

from station.devices.links.link import Link
from station.devices.zaber.protocol import ZaberError
from station.devices.zaber.stages import Condition
from station.lab.simulated_zaber import Faults
from tests.harness.zaber_bench import TICK, Bench, connected


class LossyEnd:
    """The device's end of a link that misses one message, once."""

    def __init__(self, link: Link, message: bytes) -> None:
        self.name, self.missed = link.name, 0
        self._link, self._message = link, message

    def read(self) -> bytes:
        data = self._link.read()
        if self._message in data and not self.missed:
            self.missed += 1
            return data.replace(self._message, b"", 1)
        return data

    def write(self, data: bytes) -> None:
        self._link.write(data)

    def close(self) -> None:
        self._link.close()


@pytest.fixture
def bench(paper) -> Bench:
    return connected(paper)


class TestHoming:
    """Stages are homed one after the other, and the translation is homed first."""

    def test_translation_homes_first_then_one_rotation_at_a_time(self, paper):
        bench = Bench(paper, at=(0.3, 0.6, -0.110), homed=False).connect()
        together = 0

        bench.stages.home(bench.now)
        while bench.stages.condition is Condition.HOMING and bench.now < 400:
            bench.run(TICK)
            together = max(together, sum(bench.moving))

        assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
        assert bench.order == [2, 0, 1]
        assert together == 1
        assert bench.stages.ready
        assert bench.reading.positions == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)
        assert [unit.position for unit in bench.units] == [1_536_000, 1_536_000, 0]

    def test_rotation_that_starts_below_zero_returns_to_its_zero(self, paper):
        bench = Bench(paper, at=(0.01, -math.radians(170.0), -0.129), homed=False).connect()
        bench.home()

        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)
        assert bench.reading.positions == pytest.approx(bench.truth, abs=1e-9)
        # the travel is the same as before homing
        assert [unit.settings[44] for unit in bench.units[:2]] == [3_072_000, 3_072_000]

    @pytest.mark.parametrize("pause", [0.0, 0.1, 0.4, 0.9])
    def test_stage_homes_again_while_it_restarts_after_a_stop(self, paper, pause):
        bench = Bench(paper, at=(0.0, 0.0, -0.110), homed=False).connect()
        bench.stages.home(bench.now)
        bench.run(0.6)  # the stage ignores the stop while it homes, so the chain resets it
        bench.stages.stop(bench.now)
        bench.run(pause)
        bench.home()

        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)

    def test_rotation_stopped_while_homing_still_finds_its_zero(self, paper):
        bench = Bench(paper, at=(-0.2, 0.01, -0.129), homed=False).connect()
        bench.stages.home(bench.now)
        bench.run(100.0, until=lambda: bench.truth[0] < -4.0)  # beyond half a turn
        bench.stages.stop(bench.now)
        bench.run(3.0)
        assert bench.moving == [False, False, False]
        bench.home()

        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)

    def test_stages_move_in_both_directions_after_homing(self, paper):
        bench = Bench(paper, at=(0.1, 0.1, -0.125), homed=False).connect()
        bench.home()
        bench.run(2.0, lambda now: [-0.2, 0.2, 0.01])

        assert bench.truth == pytest.approx([-0.4, 0.4, -0.110], abs=0.05)
        assert bench.reading.positions == pytest.approx(bench.truth, abs=1e-5)

    def test_stop_while_homing_is_answered_busy_and_ends_in_a_reset(self, paper):
        bench = Bench(paper, homed=False).connect()
        bench.stages.home(bench.now)
        bench.run(1.0)
        assert bench.units[2].status == 1
        bench.stages.stop(bench.now)
        bench.run(0.5)

        assert bench.moving == [False, False, False]
        assert bench.stages.condition is Condition.CONNECTED
        assert not bench.stages.homed[2]
        bench.run(2.0)
        assert not any(bench.stages.counts[i].missed for i in range(3))
        bench.home()
        assert bench.stages.ready, bench.stages.problem

    def test_lost_home_command_is_repeated(self, paper):
        bench = Bench(paper, at=(0.01, 0.01, -0.129)).connect()
        bench.far[0] = hard_of_hearing = LossyEnd(bench.far[0], bytes.fromhex("03 01 00 00 00 00"))
        bench.home()

        assert hard_of_hearing.missed == 1
        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)

    def test_noisy_line_homes_or_reports_the_fault(self, paper):
        bench = Bench(paper, at=(0.01, 0.01, -0.129), homed=False).connect()
        bench.chain.faults = Faults(drop=2e-4, flip=2e-4)
        bench.home()

        if bench.stages.ready:
            assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)
        else:
            assert bench.stages.problem

    def test_stage_that_cannot_home_is_named(self, paper):
        bench = Bench(paper, homed=False).connect()
        bench.chain.faults = Faults(stalled=frozenset({3}))
        bench.home()
        assert bench.stages.condition is Condition.FAULT
        assert "inner_translation" in bench.stages.problem
        assert "home sensor" in bench.stages.problem
        assert bench.order == [2]  # the rotations do not turn while the tubes are extended

    def test_homing_needs_a_connection(self, paper):
        with pytest.raises(ZaberError, match="closed"):
            Bench(paper).stages.home(0.0)
