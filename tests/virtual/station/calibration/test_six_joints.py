"""Calibration with six joints: signs of the axes, and a coil axis that is not used."""

import pytest

from station.calibration import commission
from station.calibration.plan import PlanSubject
from station.calibration.procedures import Effort, tracker
from station.calibration.static_lab import StaticLab
from station.calibration.static_lab import run_static as carry_out_still
from station.cli.calibrate import robot_start
from station.config.robots import load_robot
from station.lab.config import LabConfig, load_lab


@pytest.fixture(scope="module")
def subject() -> PlanSubject:
    file = load_robot("balanced_pair")
    return PlanSubject.of(file, robot_start(file))


def test_coil_axis_is_not_used_if_the_model_does_not_fit(subject):
    """Tubes that bend differently turn the tip's axis by degrees from the model's, equally at every pose."""
    lab = load_lab("uncalibrated", subject.file)

    result = carry_out_still(tracker(subject, Effort(unloaded=12)), StaticLab(subject, lab, 1))

    assert result.axis is not None
    assert result.axis.refused.startswith("the tubes differ from their description")


def test_signs_of_six_axes_are_found_where_travels_and_ends_leave_little_room(subject):
    lab = LabConfig(hidden=load_lab("uncalibrated", subject.file).hidden.model_copy(
        update={"mirrored": ("middle_rotation", "inner_translation")}
    ))  # fmt: skip

    result = carry_out_still(commission.axes(subject), StaticLab(subject, lab, 2))

    names = [joint.name for joint in subject.robot.joints]
    turned = [name for name, sign in zip(names, result.signs.signs, strict=True) if sign < 0.0]
    assert turned == ["middle_rotation", "inner_translation"]
