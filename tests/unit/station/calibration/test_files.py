"""Files of a calibration are read back unchanged, whatever names of tubes and joints they contain."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.calibration.fit import Fit
from core.calibration.quantities import Quantity, with_changes
from core.calibration.tubes import TubeCalibration
from station.calibration.files import toml_string, write_robot
from station.config.robots import JointFile, RobotFile, SectionFile, TubeFile, WorkspaceBoxFile, load_robot


@pytest.mark.parametrize("text", ["plain", 'a "quoted" \\ name', "two\nlines", "\x1b[0m tab\t", "Zoë \x7f \x85", ""])
def test_any_text_in_a_calibration_file_is_read_back_unchanged(text: str) -> None:
    written = toml_string(text)
    assert "\n" not in written
    assert tomllib.loads(f"text = {written}")["text"] == text


class NewSection(SectionFile):
    wall: float = 1.0


class NewTube(TubeFile):
    coating: str = "none"
    sections: tuple[NewSection, ...]


class NewJoint(JointFile):
    backlash: float = 0.0


class NewBox(WorkspaceBoxFile):
    margin: float = 0.0


class NewRobot(RobotFile):
    """Robot file of a later version, in which every table has an additional key."""

    serial: str = ""
    gripper: NewBox
    markers: tuple[NewBox, ...]
    tubes: tuple[NewTube, ...]
    joints: tuple[NewJoint, ...]
    workspace: NewBox


def test_calibrated_robot_file_has_every_key_of_the_original_file(tmp_path: Path) -> None:
    """The keys come from the model of the file, so that keys of later versions are tested, too."""
    paper = load_robot("paper").model_dump(exclude={"workspace", "max_force"})
    for number, tube in enumerate(paper["tubes"]):
        tube |= {"coating": f"coat {number}", "density": 6450.0, "torsional_stiffness": 0.0123 + number}
        tube["sections"] = tuple(section | {"wall": 0.25} for section in tube["sections"])
    box = {"lower": (-0.1, -0.1, 0.0), "upper": (0.1, 0.1, 0.3), "margin": 0.002}
    described = NewRobot(
        **paper | {"joints": tuple(joint | {"backlash": 1e-3} for joint in paper["joints"])},
        max_force=1.5, serial='A "7"', workspace=box, gripper=box, markers=(box, box),
    )  # fmt: skip
    nothing: Any = None  # placeholder for the results of a fit that has changed no quantity
    found = TubeCalibration(described.robot(), nothing, (), nothing, nothing)

    made = "made \x1b here\nby poses.csv"
    written = tomllib.loads(write_robot(tmp_path, described, found, made).read_text(encoding="utf-8"))

    assert NewRobot.model_validate(written, strict=False) == described.model_copy(
        update={"source": f"calibrated: {made}"}
    )
    assert written.keys() == described.model_dump(exclude_none=True).keys()


def test_comments_of_a_calibrated_tube_name_exactly_the_numbers_that_were_fitted(tmp_path: Path) -> None:
    paper = load_robot("paper")
    straight = SectionFile(length=0.01)
    outer = paper.tubes[1].model_copy(
        update={"torsional_stiffness": 0.03, "sections": (*paper.tubes[1].sections, straight, straight)}
    )
    described = paper.model_copy(update={"tubes": (paper.tubes[0], outer)})
    robot, what = described.robot(), (Quantity(1, "bending_stiffness"), Quantity(1, "end"))
    parameters = tuple(quantity.parameter(robot) for quantity in what)
    values = np.array([0.1, 2e-3])
    fit = Fit(parameters, values, np.zeros(2), np.diag([100.0, 1e4]))
    unused: Any = None
    found = TubeCalibration(with_changes(robot, what, values), unused, what, fit, unused)

    lines = write_robot(tmp_path, described, found, "made here").read_text(encoding="utf-8").splitlines()
    first, curved, middle, last = [line.strip() for line in lines if line.startswith("    { length")][2:]
    (stiffness,) = [line for line in lines if line.startswith("torsional_stiffness")]

    assert all(line.endswith(", as described") for line in (first, curved, middle))
    assert last.startswith("{ length = 0.012,")
    assert last.endswith("# [m] to where its neighbour leaves it, +-0.0002 (95 %); described 0.01")
    assert stiffness == "torsional_stiffness = 0.033  # GJ [N m^2], in the described ratio to EI"
