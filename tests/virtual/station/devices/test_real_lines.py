"""The drivers on simulated units over a real pseudo-terminal and a real socket."""

from collections.abc import Callable

import numpy as np
import pytest

from station.devices.aurora.tracker import AuroraTracker
from station.devices.interfaces import Condition
from station.devices.kernel.stages import Port
from station.devices.zaber.stages import zaber_stages
from station.lab import simulated_aurora, simulated_line
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import SimulatedAurora
from tests.harness.aurora_bench import REST
from tests.harness.real_lines import pty_line, socket_line
from tests.harness.zaber_bench import START, Bench

TICK = 1e-3


@pytest.mark.parametrize("line", [pty_line, socket_line])
def test_stages_on_a_real_line_are_found_moved_and_stopped(paper, line):
    bench = Bench(paper)
    now = 0.0
    with line() as (near, far):
        stages = zaber_stages(bench.setups, [Port(near, (0, 1, 2))])

        def until(reached: Callable[[], bool]) -> None:
            nonlocal now
            end = now + 20.0
            while not reached():
                assert now < end, stages.problem
                now += TICK
                stages.poll(now)
                simulated_line.pump(far, bench.chain, now)

        stages.connect(now)
        until(lambda: stages.condition is not Condition.CONNECTING)
        assert stages.ready, stages.problem
        stages.command(np.array([0.2, -0.2, 0.01]), now)
        until(lambda: bench.places[0] > START[0] + 0.05 and bench.places[2] > START[2] + 0.001)
        stages.stop(now)
        until(lambda: stages.at_rest)
        assert bench.moving == [False, False, False]
        until(lambda: np.abs(stages.poll(now).positions - bench.places).max() < 1e-5)


def test_tracker_on_a_real_line_is_set_up_at_a_higher_rate():
    unit = SimulatedAurora(TrackerConfig(noise=0.0), np.random.default_rng(0))
    now, read = 0.0, []
    with pty_line() as (near, far):
        tracker = AuroraTracker(near, registration=GENERATOR_POSE)
        while len(read) < 20:
            assert now < 20.0, tracker.report(now)
            unit.advance(now, now + TICK, REST, REST)
            now += TICK
            simulated_aurora.pump(far, unit, now)
            reading = tracker.poll(now)
            if reading is not None:
                read.append(reading.position)

    assert unit.baud == 115200
    assert np.array(read) == pytest.approx(np.tile(REST, (20, 1)), abs=1e-8)
