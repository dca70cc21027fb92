"""Workspace of given tubes over their joint space."""

import csv
import json

import numpy as np
import pytest

from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.cli.main import main
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.design.inverse_kinematics import spread_poses
from station.design.task import dexterity, stiffness

FORCE = np.array([0.3, 0.0, 0.1, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("name", ["paper", "three_tubes"])
def test_spread_poses_are_valid_and_within_the_travel(name):
    file = load_robot(name)
    poses = spread_poses(file, 300, 1)
    assert poses.shape == (300, len(file.joints))
    for pose in poses:
        file.limits().check(pose)
        file.robot().check_pose(pose)
    assert np.array_equal(poses, spread_poses(file, 300, 1))
    assert not np.array_equal(poses, spread_poses(file, 300, 2))


def test_a_robot_without_a_valid_pose_is_refused_with_its_name():
    file = load_robot("paper")
    joints = tuple(
        joint.model_copy(update={"lower": -0.9, "upper": -0.8}) if joint.motion == "translation" else joint
        for joint in file.joints
    )
    with pytest.raises(ConfigError, match="'paper': almost no joint position is valid"):
        spread_poses(file.model_copy(update={"joints": joints}), 2, 0)


def test_the_dexterity_is_the_speed_in_the_slowest_direction():
    file = load_robot("paper")
    model, speed = Statics(file.robot()), file.limits().speed
    random = np.random.default_rng(0)
    for pose in spread_poses(file, 20, 0):
        now = model.solve(pose, FORCE)
        slowest = float(dexterity(now.jacobian[None], speed)[0])
        directions = random.normal(size=(20_000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        speeds = np.linalg.norm(directions @ (now.jacobian[:3] * speed).T, axis=1)
        assert slowest <= speeds.min() <= slowest + 0.03 * speeds.max()


def test_a_robot_with_two_joints_has_a_dexterity_of_zero():
    assert dexterity(np.ones((4, 6, 2)), np.ones(2)).tolist() == [0.0] * 4


def test_the_stiffness_is_that_of_the_exact_rod_in_its_softest_direction():
    file = load_robot("paper")
    model, rod = Statics(file.robot()), ExactRod(file.robot())
    for pose in spread_poses(file, 5, 0):
        now, at = model.solve(pose, FORCE), rod.solve(pose, FORCE)
        columns = []
        for axis in np.eye(6)[:3]:
            ends = [rod.solve(pose, FORCE + sign * 1e-3 * axis, at).tip for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / 2e-3)
        softest = np.linalg.svd(np.column_stack(columns), compute_uv=False)[0]
        assert float(stiffness(now.compliance[None])[0]) == pytest.approx(1.0 / softest, rel=2e-3)


def test_the_workspace_command_writes_numbers_poses_and_figures(tmp_path, capsys):
    words = "workspace paper --force 0.5 0 -0.1 --poses 200 --data"
    assert main([*words.split(), str(tmp_path)]) == 0
    (folder,) = (tmp_path / "workspaces").iterdir()
    text = " ".join(capsys.readouterr().out.split())
    assert [word for word in ("[mm/s]", "[N/m]", "[1]", "cm^3") if word not in text] == []
    answer = json.loads((folder / "workspace.json").read_text())
    assert (answer["poses"], answer["without_shape"], answer["force_n"]) == (200, 0, [0.5, 0.0, -0.1])
    with (folder / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    model = Statics(load_robot("paper").robot())
    names = ("outer_rotation [rad]", "inner_rotation [rad]", "inner_translation [m]")
    pose = np.array([float(rows[7][name]) for name in names])
    tip = [float(rows[7][f"tip_{axis} [m]"]) for axis in "xyz"]
    assert len(rows) == 200
    assert model.solve(pose, np.array([0.5, 0, -0.1, 0, 0, 0])).tip == pytest.approx(tip, abs=1e-6)
    tips = 1e3 * np.array([[float(row[f"tip_{axis} [m]"]) for axis in "xyz"] for row in rows])
    assert [answer["reach_mm"][axis]["most"] for axis in "xyz"] == pytest.approx(tips.max(axis=0).tolist(), abs=2e-3)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == 3
    assert "Workspace of &#x27;paper&#x27; under 0.5 / 0 / -0.1 N (x / y / z)" in page


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("workspace nowhere", "'nowhere' is not one of the robots"),
        ("workspace paper --out /dev/null", "cannot write results"),
    ],
)
def test_an_invalid_workspace_command_is_refused_in_one_line(words, message, capsys):
    assert main([*words.split(), *([] if "nowhere" in words else ["--poses", "5"])]) == 2
    answer = capsys.readouterr().err
    assert message in answer
    assert answer.count("\n") == 1


def test_a_workspace_force_without_a_model_solution_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["workspace", "paper", "--force", "1e4", "0", "0"])
    assert "1e4 N is outside -100 ... 100 N" in capsys.readouterr().err
