"""Calibration with six joints on one chain: compensation of a misaligned coil."""

import math
from pathlib import Path

import numpy as np
import pytest

from station.calibration.headless import run_headless
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import PlanSubject
from station.calibration.procedures import Effort, TrackerResult, tracker
from station.calibration.static_lab import StaticLab
from station.cli.calibrate import robot_start
from station.config.robots import load_robot
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import angles
from station.lab.config import load_lab
from tests.harness.cases import a_run

ASKEW = math.radians(3.0)
#: Lab with exactly the robot file's tubes and a coil misaligned by 3 degrees, which causes all of the direction error.
LAB = f"""
title = "misaligned coil"
[plant]
tubes = {{}}
play = {{}}
poisson_ratio = 0.30
friction_force = 0.0
friction_moment = 0.0
[hidden]
coil_misalignment = {ASKEW!r}
"""


@pytest.fixture(scope="module")
def subject() -> PlanSubject:
    file = load_robot("balanced_pair")
    return PlanSubject.of(file, robot_start(file))


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("lab") / "misaligned.toml"
    path.write_text(LAB, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found(subject, lab) -> TrackerResult:
    """Return the result of the procedure `tracker` on the wire-level devices, from few poses."""
    few = tracker(subject, Effort(unloaded=6))
    return run_headless(few, subject, load_lab(str(lab), subject.file), 1, VirtualClock(), lambda done, text: None)


def test_axis_of_a_misaligned_coil_is_found_at_wire_level(subject, lab, found):
    true = StaticLab(subject, load_lab(str(lab), subject.file), 1).hidden.coil_axis

    assert found.axis is not None
    assert not found.axis.refused
    assert math.acos(true[2]) == pytest.approx(ASKEW)
    assert math.acos(min(float(found.axis.direction @ true), 1.0)) < math.radians(0.3)


def test_calibrated_coil_axis_removes_three_degrees_of_direction_error(subject, lab, found, tmp_path):
    write_all(
        tmp_path / "known", found, subject, Provenance("tracker", "2026-01-01T00:00:00+00:00", "a lab", 1, 1.0, True)
    )
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
