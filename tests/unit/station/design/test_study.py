"""Study files: errors with key and line, and the robots that they describe."""

import pytest

from station.calibration.files import robot_text
from station.config.robots import load_robot, robot_of
from station.config.strict import ConfigError, preset_names
from station.design.study import load_study

TEXT = """title = "one"
robot = "paper"

[task]
points = [[0.02459, -0.04154, 0.19392]]
forces = [[0.5, 0.0, 0.0]]

[[parameters]]
key = "inner.sections.2.curvature"
lower = 1.0
upper = 9.0
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "one.toml"

    def load(text=TEXT):
        path.write_text(text)
        return load_study(str(path))

    return load


def test_the_preset_design_studies_can_be_loaded():
    assert preset_names("studies") == ["fig10_load"]
    for name in preset_names("studies"):
        assert load_study(name).start_parameters.tolist() == [0.15, 0.153, 4.0, 0.153, 4.0]


def test_a_candidate_robot_differs_from_the_start_robot_only_in_the_parameters(study):
    before, after = load_robot("paper"), study().changed([7.5])
    assert after.tubes[0].sections[1].curvature == (7.5, 0.0)
    assert after.tubes[0].sections[1].length == before.tubes[0].sections[1].length
    assert (after.tubes[1], after.joints) == (before.tubes[1], before.joints)


@pytest.mark.parametrize("name", ["paper", "three_tubes", "nylon"])
def test_a_written_robot_file_is_read_back_unchanged(name):
    file = load_robot(name)
    assert robot_of(robot_text(file), "it") == file


@pytest.mark.parametrize(
    ("what", "instead", "message"),
    [
        ('"inner.sections.2.curvature"', '"middle.bending_stiffness"', "has no tube 'middle'; it has inner, outer"),
        ('"inner.sections.2.curvature"', '"inner.sections.3.length"', "tube 'inner' has the sections 1 ... 2"),
        ('"inner.sections.2.curvature"', '"inner.colour"', "is none of inner.bending_stiffness"),
        ("lower = 1.0", "lower = 9.0", "lower 9 is not below upper 9"),
        ("curvature", "length", "tubes.0.sections.1.length = 9.0: Input should be less than or equal to 5"),
        ("[[0.5, 0.0, 0.0]]", "[[0.0, 0.0, 0.0]]", "one of the forces must be more than 0 N"),
        ('title = "one"', 'titel = "one"', "unknown key 'titel' (line 1)"),
        ("forces", "force", "unknown key 'task.force' (line 6)"),
        ('robot = "paper"', 'robot = "nobody"', "'nobody' is not one of the robots"),
        ("points = [[0.02459", "points = [[nan", "points"),
    ],
)
def test_an_error_in_a_design_study_names_file_and_key(study, what, instead, message):
    with pytest.raises(ConfigError) as refused:
        study(TEXT.replace(what, instead))
    assert message in str(refused.value)
    assert "one.toml" in str(refused.value)


def test_a_robot_file_in_the_folder_of_the_study_is_found(study, tmp_path):
    file = load_robot("paper").model_copy(update={"name": "mine", "working_pose": None})
    (tmp_path / "mine.toml").write_text(robot_text(file))
    assert study(TEXT.replace('"paper"', '"mine.toml"')).robot == file
