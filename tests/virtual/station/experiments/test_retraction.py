"""The closed loop draws the inner tube into the outer one and out again, and the tip follows its path."""

import numpy as np
import pytest

from core.model.statics import Statics
from station.config.robots import load_robot
from station.config.strict import PRESETS
from station.experiments.experiment import load_experiment
from tests.harness.cases import a_run

START = np.array([0.0, 1.2, -0.125])
#: Poses on the path; from -0.138 m on the inner tube ends inside the outer one.
PATH = [(4.0, np.array([0.1, 1.3, -0.137])), (8.0, np.array([0.2, 1.4, -0.170])), (16.0, START)]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lab", ["ideal", "realistic"])
def test_motion_starts_where_all_tubes_are_flush_with_the_plate(tmp_path, lab):
    text = (PRESETS / "robots" / "three_tubes.toml").read_text(encoding="utf-8")
    for before, length in (("-0.330", "-0.463"), ("-0.225", "-0.3305"), ("-0.145", "-0.199")):
        text = text.replace(f"lower = {before}", f"lower = {length}")
    (tmp_path / "flush.toml").write_text(text, encoding="utf-8")
    (tmp_path / "flush_start.toml").write_text(f"""
title = "flush"
robot = "flush.toml"
lab = "{lab}"
duration = 4.0
settling = 0.0
trajectory = {{ kind = "joint_sweep", joint = "inner_translation", speed = 0.01, distance = 0.03 }}
[start]
outer_rotation = 0.0
middle_rotation = 1.0
inner_rotation = 2.0
outer_translation = -0.199
middle_translation = -0.3305
inner_translation = -0.463
""", encoding="utf-8")  # fmt: skip
    (case,) = load_experiment(str(tmp_path / "flush_start.toml")).cases
    run = a_run(case)

    assert run.completed, run.cause
    tips = run.channels.of(run.rows, "tip_true")
    assert np.linalg.norm(tips[0]) < 1e-6  # the tip is at the plate
    assert 0.0290 < np.linalg.norm(tips[-1]) < 0.0301


@pytest.mark.parametrize(("lab", "most"), [("gentle", 1.5e-3), ("realistic", 3e-3)])
def test_tip_follows_its_path_when_the_inner_tube_is_drawn_into_the_outer_one(tmp_path, lab, most):
    robot = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8").replace("lower = -0.130", "lower = -0.250")
    (tmp_path / "deep.toml").write_text(robot, encoding="utf-8")
    model, none = Statics(load_robot(str(tmp_path / "deep.toml")).robot()), np.zeros(6)
    tip = model.solve(START, none).tip
    points = [[time, *(model.solve(pose, none).tip - tip).tolist()] for time, pose in PATH]
    (tmp_path / "retraction.toml").write_text(f"""
title = "retraction"
robot = "deep.toml"
lab = "{lab}"
duration = 18.0
settling = 0.0
start = {{ outer_rotation = 0.0, inner_rotation = 1.2, inner_translation = -0.125 }}
load = {{ kind = "constant", magnitude = 0.1, direction = [0.0, 1.0, 0.0] }}
[trajectory]
kind = "waypoints"
points = {points}
[controller]
inner = "type_2"
feedback = "observer"
feedforward = true
""", encoding="utf-8")  # fmt: skip
    (case,) = load_experiment(str(tmp_path / "retraction.toml")).cases
    run = a_run(case)

    assert run.completed, run.cause
    joints, tips, desired = (run.channels.of(run.rows, name) for name in ("joints", "tip_true", "tip_desired"))
    assert joints[:, 2].min() < -0.160
    assert np.linalg.norm(np.diff(tips, axis=0), axis=1).max() < 2e-4  # no jump in 2 ms
    assert np.percentile(np.linalg.norm(tips - desired, axis=1), 95) < most
    assert np.linalg.norm(tips[-1] - desired[-1]) < most
