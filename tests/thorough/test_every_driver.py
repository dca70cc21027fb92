"""Every built-in driver of stages: `check-driver`, and a circle under a load."""

import numpy as np
import pytest

from station.experiments.experiment import load_experiment
from station.lab.simulated_stages import STAGES
from tests.harness.cases import a_run
from tests.harness.stages_bench import KINDS
from tests.virtual.station.devices.test_driver_check import findings

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


@pytest.mark.parametrize("kind", list(KINDS))
def test_built_in_drivers_pass_every_check(paper, kind):
    assert [finding for finding in findings(paper, kind).values() if not finding.good] == []


@pytest.mark.parametrize("kind", list(STAGES))
def test_tip_follows_a_circle_under_load_within_a_millimetre(tmp_path, kind):
    (tmp_path / "circle.toml").write_text(f'{CIRCLE}lab = {{ stages = "{kind}" }}\n', encoding="utf-8")
    recording = a_run(load_experiment(str(tmp_path / "circle.toml")).cases[0])
    assert recording.completed, recording.cause
    desired, true = (recording.channels.of(recording.rows, group) for group in ("tip_desired", "tip_true"))
    assert np.sqrt(np.square(np.linalg.norm(desired - true, axis=1)).mean()) <= 1.0e-3
    assert np.ptp(true[:, :2], axis=0) == pytest.approx([0.020, 0.020], abs=0.004)
