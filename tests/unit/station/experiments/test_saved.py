"""Saved experiments are found by name in the data folder, unless another folder of experiments is in use."""

import pytest

from station.config.controllers import DEFAULT_CONTROLLER
from station.config.loads import TrapezoidLoad
from station.config.motions import WaypointsMotion
from station.config.strict import EXPERIMENTS_VARIABLE, preset_names
from station.experiments.experiment import load_experiment
from station.experiments.saved import EXPERIMENTS_FOLDER, FreeMotion, SavedAlreadyError, save, saved_motion, use_saved

MOTION = FreeMotion(
    title="there and back",
    start={"outer_rotation": 0.0, "inner_rotation": 1.5707963267948966, "inner_translation": -0.1},
    duration=12.0,
    trajectory=WaypointsMotion(points=((5.0, 0.0, 0.004, 0.0), (9.0, 0.0, 0.0, 0.0))),
    controller=DEFAULT_CONTROLLER,
    load=TrapezoidLoad(magnitude=0.1, rise=1.0),
)
ABOUT = {"robot": "paper", "lab": "gentle"}


@pytest.fixture
def nothing_in_use(monkeypatch):
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")


def test_another_process_with_the_same_data_folder_finds_a_saved_experiment(nothing_in_use, monkeypatch, tmp_path):
    path = save(MOTION, "there", tmp_path, ABOUT, replace=False)
    assert path == tmp_path / EXPERIMENTS_FOLDER / "there.toml"
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")  # as in another process, in which the variable is not set
    assert "there" not in preset_names("experiments")
    use_saved(tmp_path)
    assert load_experiment("there").cases[0].lab == load_experiment("fig10").cases[0].lab
    assert saved_motion("there") == MOTION


def test_use_saved_keeps_a_folder_of_experiments_that_the_user_selected(nothing_in_use, monkeypatch, tmp_path):
    save(MOTION, "there", tmp_path, ABOUT, replace=False)
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, str(own))
    use_saved(tmp_path)
    assert "there" not in preset_names("experiments")
    save(MOTION, "here", tmp_path, ABOUT, replace=False)
    assert [path.name for path in own.iterdir()] == ["here.toml"]
    with pytest.raises(SavedAlreadyError, match="name = 'here'"):
        save(MOTION, "here", tmp_path, ABOUT, replace=False)


def test_use_saved_changes_nothing_if_the_data_folder_has_no_saved_experiments(nothing_in_use, tmp_path):
    before = preset_names("experiments")
    use_saved(tmp_path)
    assert preset_names("experiments") == before
