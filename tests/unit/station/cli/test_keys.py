"""The page of all files of one's own is that of the models that check them, and its worked files work."""

import re
from pathlib import Path

import numpy as np
import pytest

from station.cli import keys
from station.config.motions import CircleMotion, Orders
from station.config.robots import RobotFile, named_pose
from station.config.strict import OWN_EXPERIMENTS, preset_names
from station.control.known_calibration import RegistrationFile, SensorsFile
from station.design.study import StudyFile
from station.experiments.experiment import CaseFile, load_experiment
from station.lab.config import LabConfig
from station.service.goto import check_way, to_working_pose
from station.service.station_file import StationFile, load_station

FILES = Path(keys.__file__).parents[1] / "FILES.md"


def test_the_page_is_what_the_command_prints():
    assert FILES.read_text(encoding="utf-8") == keys.page(), "print it anew: python -m station keys > station/FILES.md"


@pytest.mark.parametrize(
    "model", [RobotFile, StationFile, LabConfig, CaseFile, RegistrationFile, SensorsFile, StudyFile]
)
def test_every_key_of_every_file_is_on_it(model):
    text = keys.page()
    for key in model.model_fields:
        assert f"| `{key}` |" in text


def rows() -> list[tuple[str, str, str]]:
    """Of every table: key, value, and what it says of them."""
    lines = [line.replace("\\|", "/").strip("| ").split(" | ") for line in keys.page().splitlines() if "| `" in line]
    return [(line[0], line[1], line[3] if len(line) > 3 else "") for line in lines]


def test_every_key_has_words_and_not_only_a_unit():
    assert len(rows()) > 150
    for key, _, words in rows():
        assert key == "`kind`" or re.fullmatch(r"(\[[^]]*])?", words) is None, f"{key} needs a sentence"


def test_a_number_has_a_unit_or_is_a_part_of_something_and_its_range_stands_in_either_column():
    for key, value, words in rows():
        if not value.startswith("number"):
            continue
        assert value != "number" or re.search(r"greater than|below|above|\.\.\.|any|not positive", words), key
        if "[" not in words:
            assert key.strip("`") in WITHOUT_UNIT, f"{key}: {words}"


#: Numbers that are parts, ratios and counts.
WITHOUT_UNIT = {
    "poisson_ratio", "stability", "hold_share", "rate", "vary", "friction", "walk", "gain", "stiffness", "curvature",
    "breathing_second", "value", "rate_drift", "size_drift", "damping", "turns", "margin", "lower", "upper",
}  # fmt: skip


@pytest.mark.parametrize("kind", ["circle", "csv", "joint_sweep", "waypoints", "hung_weight", "contact", "ramps"])
def test_every_kind_of_motion_and_load_has_its_table(kind):
    assert f'| `kind` | `"{kind}"` | **required** |' in keys.page()


def test_every_link_leads_to_a_heading():
    text = keys.page()
    titles = [line.lstrip("#").strip() for line in text.splitlines() if line.startswith("#")]
    headings = {title.lower().replace(" ", "-") for title in titles}
    linked = {part.split(")")[0] for part in text.split("](#")[1:]}
    assert linked
    assert linked <= headings


@pytest.fixture
def worked(monkeypatch, tmp_path):
    """The worked station, from a folder that is not its own."""
    monkeypatch.setenv(OWN_EXPERIMENTS, "")  # put back after the test
    monkeypatch.chdir(tmp_path)
    return load_station(keys.WORKED / "station.toml").bench()


def test_the_worked_station_takes_its_robot_lab_and_experiments(worked):
    assert (worked.robot.name, worked.lab.title, worked.seed) == ("mine", "virtual lab: mine", 1)
    assert worked.warnings == ()  # its tubes do not snap
    assert "square" in preset_names("experiments")


def test_the_worked_experiment_is_one_and_its_load_is_borne(worked):
    experiment = load_experiment("square")
    assert [case.name for case in experiment.cases] == ["default", "paper"]
    assert all(case.robot == worked.robot for case in experiment.cases)
    assert all(case.warnings == () for case in experiment.cases)


def test_the_worked_robots_working_pose_is_reached_and_has_room(worked):
    homed = np.array([0.0, 0.0, -0.105])
    check_way(worked, to_working_pose(worked), homed)
    assert worked.robot.working_pose is not None
    pose = named_pose(worked.robot.working_pose, worked.robot, "working_pose")
    Orders(CircleMotion(radius=0.01, period=20.0), worked.robot.robot()).check(
        worked.controlled(worked.controller), pose, 60.0
    )
