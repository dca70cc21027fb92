"""What only G-code boards do: planner queue, alarms and restarts, on simulated boards in virtual time."""

import numpy as np
import pytest

from station.devices.interfaces import Condition
from station.experiments.experiment import load_experiment
from station.lab.simulated_zaber import Faults
from tests.harness.cases import a_run
from tests.harness.stages_bench import StagesBench

SPEEDS = [0.3, -0.3, 0.015]


@pytest.fixture(params=["grbl", "marlin"])
def bench(paper, request) -> StagesBench:
    return StagesBench(paper, request.param).connect().run(1.0, lambda now: SPEEDS)


def time_to_fault(bench: StagesBench) -> float:
    start = bench.now
    bench.run(1.0, lambda now: SPEEDS, until=lambda: bench.stages.condition is Condition.FAULT)
    return bench.now - start


def test_stop_brings_every_axis_to_rest_within_100_ms_with_segments_in_the_planner(bench):
    assert bench.simulated.planner.blocks
    start = bench.now
    bench.stages.stop(bench.now)
    bench.run(0.5, until=lambda: not bench.simulated.planner.moving)
    assert bench.now - start <= 0.1


def test_alarm_is_a_fault_within_300_ms_with_its_meaning(bench):
    bench.simulated.raise_alarm(1)
    assert time_to_fault(bench) <= 0.3
    assert "a limit switch was hit" in bench.cause or "Printer halted" in bench.cause


def test_restart_of_the_board_is_a_fault_after_which_no_axis_counts_as_homed(bench):
    bench.simulated.power_cycle(1)
    bench.run(1.0, lambda now: SPEEDS)
    assert bench.stages.condition is Condition.FAULT
    assert not any(bench.stages.details()[name]["homed"] for name in ("outer_rotation", "inner_translation"))


def test_cut_line_is_a_fault_within_300_ms_and_the_stages_stop_by_themselves(bench):
    bench.simulated.faults = Faults(cut=1)
    assert time_to_fault(bench) <= 0.3
    assert "no answer of the board" in bench.cause
    assert not bench.simulated.planner.moving


CIRCLE = """
title = "circle"
start = { outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }
duration = 20.0
settling = 0.0
trajectory = { kind = "circle", radius = 0.010, period = 20.0 }
load = { kind = "constant", magnitude = 0.1 }
[cases.feedforward]
controller = { feedforward = true }
"""


@pytest.mark.parametrize("dialect", ["grbl", "marlin"])
def test_tip_on_a_gcode_board_follows_a_circle_under_load_within_a_millimetre(tmp_path, dialect):
    (tmp_path / "circle.toml").write_text(f'{CIRCLE}lab = {{ stages = "{dialect}" }}\n', encoding="utf-8")
    recording = a_run(load_experiment(str(tmp_path / "circle.toml")).cases[0])
    assert recording.completed, recording.cause
    desired, true = (recording.channels.of(recording.rows, group) for group in ("tip_desired", "tip_true"))
    assert np.sqrt(np.square(np.linalg.norm(desired - true, axis=1)).mean()) <= 1.0e-3
    assert np.ptp(true[:, :2], axis=0) == pytest.approx([0.020, 0.020], abs=0.004)
