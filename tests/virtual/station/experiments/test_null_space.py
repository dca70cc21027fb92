"""The null-space objective does not disturb the tip where the Jacobian jumps."""

import numpy as np

from station.experiments.experiment import load_experiment
from tests.harness.cases import a_run

#: Experiment at a kink, i.e. a pose where the Jacobian jumps: the start of the inner tube's curve approaches the end of
#: the balanced pair. It repeats seconds 37 to 44 of `points` without the load: its waypoints move the tip as the circle
#: and the deflection by the load did together.
AT_A_KINK = """
title = "At a kink"
robot = "balanced_pair"
lab = "pointing"
duration = 7.0
settling = 0.0
[start]
outer_rotation = 0.475
middle_rotation = 1.626
inner_rotation = 3.81
outer_translation = -0.03117
middle_translation = -0.09059
inner_translation = -0.15062
[trajectory]
kind = "waypoints"
points = [
    [2.0, -0.001, 0.0042, 0.0],
    [4.0, -0.003, 0.0082, 0.0],
    [6.0, -0.009, 0.0104, 0.0],
    [8.0, -0.0155, 0.011, 0.0],
]
[controller]
inner = "type_2"
feedback = "observer"
feedforward = true
filter_bandwidth = 0.7
null_space = { stability = 1.0, limits = 1.0, order = 1.0 }
"""


def test_redundant_joints_do_not_oscillate_at_a_pose_where_the_jacobian_jumps(tmp_path):
    path = tmp_path / "at_a_kink.toml"
    path.write_text(AT_A_KINK, encoding="utf-8")
    (case,) = load_experiment(str(path)).cases
    run = a_run(case, seed=41)
    assert run.completed, run.cause
    tip, desired = (run.channels.of(run.rows, group) for group in ("tip_true", "tip_desired"))
    distance = np.linalg.norm(tip - desired, axis=1)
    assert np.percentile(distance, 95) < 5e-4  # [m]; the distance is 2.4 mm if the joints oscillate
