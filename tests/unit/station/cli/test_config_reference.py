"""The reference page of the configuration files matches the models that check them, and its examples are valid."""

import re

import numpy as np
import pytest

from station.cli import config_reference
from station.cli.main import main
from station.config.motions import CircleMotion, Orders
from station.config.robots import named_pose
from station.config.strict import EXPERIMENTS_VARIABLE, preset_names
from station.devices.registry import BUILT_IN_DRIVERS
from station.experiments.experiment import load_experiment
from station.service.feasibility import check_path, goto_working_pose
from station.service.station_file import load_station


def test_command_keys_prints_a_section_for_each_kind_of_file(capsys):
    assert main(["keys"]) == 0
    printed = capsys.readouterr().out
    for kind in ("Robot", "Station", "Virtual lab", "Experiment", "Study"):
        assert f"\n## {kind}\n" in printed


def test_reference_page_has_the_options_of_every_built_in_driver():
    text = config_reference.reference_page()
    names = [name for drivers in BUILT_IN_DRIVERS.values() for name in drivers]
    assert [name for name in names if f"\n## Driver {name}\n" not in text] == []


def rows() -> list[tuple[str, str, str]]:
    """Return key, value and description of every row of every table."""
    lines = [
        line.replace("\\|", "/").strip("| ").split(" | ")
        for line in config_reference.reference_page().splitlines()
        if "| `" in line
    ]
    return [(line[0], line[1], line[3] if len(line) > 3 else "") for line in lines]


def test_key_has_a_description_and_not_only_a_unit():
    assert len(rows()) > 150
    for key, _, words in rows():
        assert key == "`kind`" or re.fullmatch(r"(\[[^]]*])?", words) is None, f"{key} needs a sentence"


def test_numeric_key_has_a_unit_or_is_dimensionless_and_has_its_range():
    for key, value, words in rows():
        if not value.startswith("number"):
            continue
        assert value != "number" or re.search(
            r"greater than|less than|at most|below|above|\.\.\.|any|not positive", words
        ), key
        if "[" not in words:
            assert key.strip("`") in WITHOUT_UNIT, f"{key}: {words}"


#: Numeric keys without a unit: fractions, ratios and counts.
WITHOUT_UNIT = {
    "poisson_ratio", "hold_share", "rate", "vary", "friction", "walk", "gain", "stiffness", "curvature", "uncertainty",
    "breathing_second", "value", "rate_drift", "size_drift", "damping", "turns", "margin", "lower", "upper",
    "strength", "max_strain",
}  # fmt: skip


@pytest.mark.parametrize("kind", ["circle", "csv", "joint_sweep", "waypoints", "hung_weight", "contact", "ramps"])
def test_reference_page_has_a_table_for_every_kind_of_motion_and_load(kind):
    assert f'| `kind` | `"{kind}"` | **required** |' in config_reference.reference_page()


def test_links_of_the_reference_page_match_its_headings():
    text = config_reference.reference_page()
    titles = [line.lstrip("#").strip() for line in text.splitlines() if line.startswith("#")]
    headings = {title.lower().replace(" ", "-") for title in titles}
    linked = {part.split(")")[0] for part in text.split("](#")[1:]}
    assert linked
    assert linked <= headings


@pytest.fixture
def worked(monkeypatch, tmp_path):
    """Return the rig of the example station file, loaded while another working folder is set."""
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")  # pytest restores this variable after the test
    monkeypatch.chdir(tmp_path)
    return load_station(config_reference.WORKED_EXAMPLES / "station.toml").bench()


def test_example_station_loads_its_robot_lab_and_experiments(worked):
    assert (worked.robot.name, worked.lab.title, worked.seed) == ("mine", "virtual lab: mine", 1)
    assert worked.warnings == ()  # there is no warning that its tubes snap
    assert "square" in preset_names("experiments")


def test_example_experiment_is_valid_and_its_load_is_below_the_strength(worked):
    experiment = load_experiment("square")
    assert [case.name for case in experiment.cases] == ["default", "paper"]
    assert all(case.robot == worked.robot for case in experiment.cases)
    assert all(case.warnings == () for case in experiment.cases)


def test_working_pose_of_the_example_robot_is_reachable_and_has_room(worked):
    homed = np.array([0.0, 0.0, -0.105])
    check_path(worked, goto_working_pose(worked), homed)
    assert worked.robot.working_pose is not None
    pose = named_pose(worked.robot.working_pose, worked.robot, "working_pose")
    Orders(CircleMotion(radius=0.01, period=20.0), worked.robot.robot()).check(
        worked.controlled(worked.controller), pose, 60.0
    )
