"""What was saved is found by name from the folder of data, unless another folder of experiments is in use."""

import pytest

from station.config.controllers import BEST
from station.config.motions import WaypointsMotion
from station.config.strict import OWN_EXPERIMENTS, preset_names
from station.experiments.experiment import load_experiment
from station.experiments.saved import FOLDER, FreeMotion, SavedAlreadyError, save, saved_motion, use_saved
from station.lab.loads import TrapezoidLoad

MOTION = FreeMotion(
    title="there and back",
    start={"outer_rotation": 0.0, "inner_rotation": 1.5707963267948966, "inner_translation": -0.1},
    duration=12.0,
    trajectory=WaypointsMotion(points=((5.0, 0.0, 0.004, 0.0), (9.0, 0.0, 0.0, 0.0))),
    controller=BEST,
    load=TrapezoidLoad(magnitude=0.1, rise=1.0),
)
ABOUT = {"robot": "paper", "lab": "gentle"}


@pytest.fixture
def nothing_in_use(monkeypatch):
    monkeypatch.setenv(OWN_EXPERIMENTS, "")


def test_it_is_found_by_who_has_the_same_folder_of_data(nothing_in_use, monkeypatch, tmp_path):
    path = save(MOTION, "there", tmp_path, ABOUT, replace=False)
    assert path == tmp_path / FOLDER / "there.toml"
    monkeypatch.setenv(OWN_EXPERIMENTS, "")  # another process
    assert "there" not in preset_names("experiments")
    use_saved(tmp_path)
    assert load_experiment("there").cases[0].lab == load_experiment("fig10").cases[0].lab
    assert saved_motion("there") == MOTION


def test_another_folder_that_is_in_use_stays_in_use(nothing_in_use, monkeypatch, tmp_path):
    save(MOTION, "there", tmp_path, ABOUT, replace=False)
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setenv(OWN_EXPERIMENTS, str(own))
    use_saved(tmp_path)
    assert "there" not in preset_names("experiments")
    save(MOTION, "here", tmp_path, ABOUT, replace=False)
    assert [path.name for path in own.iterdir()] == ["here.toml"]
    with pytest.raises(SavedAlreadyError, match="name = 'here'"):
        save(MOTION, "here", tmp_path, ABOUT, replace=False)


def test_without_a_folder_nothing_changes(nothing_in_use, tmp_path):
    before = preset_names("experiments")
    use_saved(tmp_path)
    assert preset_names("experiments") == before
