"""Homing of simulated stages: order, direction, stops, and stages that cannot home."""

import pytest

from station.devices.interfaces import Condition
from station.devices.links.link import Link
from station.lab.simulated_line import Faults
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
        bench = Bench(paper, at=(0.1, 0.2, -0.125), homed=False).connect()
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

    @pytest.mark.parametrize("pause", [0.0, 0.4])
    def test_stage_homes_again_while_it_restarts_after_a_stop(self, paper, pause):
        bench = Bench(paper, at=(0.0, 0.0, -0.110), homed=False).connect()
        bench.stages.home(bench.now)
        bench.run(0.6)  # the stage ignores the stop while it homes, so the chain resets it
        bench.stages.stop(bench.now)
        bench.run(pause)
        bench.home()

        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)

    def test_lost_home_command_is_repeated(self, paper):
        bench = Bench(paper, at=(0.01, 0.01, -0.129)).connect()
        bench.far[0] = hard_of_hearing = LossyEnd(bench.far[0], bytes.fromhex("03 01 00 00 00 00"))
        bench.home()

        assert hard_of_hearing.missed == 1
        assert bench.stages.ready, bench.stages.problem
        assert bench.truth == pytest.approx([0.0, 0.0, -0.130], abs=1e-9)

    def test_stage_that_cannot_home_is_named(self, paper):
        bench = Bench(paper, homed=False).connect()
        bench.chain.faults = Faults(stalled=frozenset({3}))
        bench.home()
        assert bench.stages.condition is Condition.FAULT
        assert "inner_translation" in bench.stages.problem
        assert "home sensor" in bench.stages.problem
        assert bench.order == [2]  # the rotations do not turn while the tubes are extended
