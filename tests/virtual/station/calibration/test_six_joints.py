"""Six joints on one chain: from where the axes have room, and a coil askew made good while the tip points."""

import math
from pathlib import Path

import numpy as np
import pytest

from station.calibration import commission
from station.calibration.headless import carry_out
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import Subject
from station.calibration.procedures import Effort, TrackerResult, tracker
from station.calibration.static_lab import StaticLab
from station.calibration.static_lab import carry_out as carry_out_still
from station.cli.calibrate import robot_start
from station.config.robots import load_robot
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import angles
from station.lab.config import LabConfig, load_lab
from tests.harness.cases import a_run

ASKEW = math.radians(3.0)
#: The described tubes, and a coil 3 degrees askew: what is left of the direction's error is the coil's.
LAB = f"""
title = "coil askew"
[plant]
tubes = {{}}
play = {{}}
poisson_ratio = 0.30
friction_force = 0.0
friction_moment = 0.0
[hidden]
coil_askew = {ASKEW!r}
"""


@pytest.fixture(scope="module")
def subject() -> Subject:
    file = load_robot("balanced_pair")
    return Subject.of(file, robot_start(file))


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("lab") / "askew.toml"
    path.write_text(LAB, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found(subject, lab) -> TrackerResult:
    """On the wire-level devices, from few poses."""
    few = tracker(subject, Effort(unloaded=6))
    return carry_out(few, subject, load_lab(str(lab), subject.file), 1, VirtualClock(), lambda done, text: None)


def test_the_axis_of_a_coil_askew_is_found_over_the_wire(subject, lab, found):
    true = StaticLab(subject, load_lab(str(lab), subject.file), 1).hidden.coil_axis

    assert found.axis is not None
    assert not found.axis.refused
    assert math.acos(true[2]) == pytest.approx(ASKEW)
    assert math.acos(min(float(found.axis.direction @ true), 1.0)) < math.radians(0.3)


def test_the_tip_points_where_it_should_once_the_coil_is_known_and_three_degrees_off_before(
    subject, lab, found, tmp_path
):
    write_all(tmp_path / "known", found, subject, Provenance("tracker", "2026-01-01T00:00:00+00:00", "a lab", 1, 1.0))
    errors = []
    for calibration in ("", str(tmp_path / "known")):
        changes = {"lab": str(lab), "calibration": calibration, "duration": 5.0, "settling": 2.0}
        case = next(case for case in load_experiment("points", changes).cases if case.name == "pointing")
        run = a_run(case, 1)
        assert run.completed, run.cause
        moving = run.channels.of(run.rows, "direction_desired").any(axis=1)
        wanted, true = (run.channels.of(run.rows[moving][-1000:], f"direction_{w}") for w in ("observed", "true"))
        errors.append(np.sqrt(np.mean(angles(wanted, true) ** 2)))

    assert errors[0] == pytest.approx(3.0, abs=0.4)
    assert errors[1] < 1.0


def test_a_doubtful_model_is_not_asked_for_the_coils_axis(subject):
    """Tubes that bend otherwise lay the tip's axis degrees beside the model's, the same way at every pose."""
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
