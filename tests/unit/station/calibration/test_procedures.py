"""The calibration procedures on a simulated uncalibrated bench, from the first pose to the files.

The true parameters of the simulation serve for comparison only.
"""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.calibration.contact import locate_contact
from core.calibration.measurements import Noise
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.calibration import commission, procedures
from station.calibration.outcome import Provenance, write_all
from station.calibration.plan import PlanSubject
from station.calibration.static_lab import StaticLab, run_static
from station.calibration.summary import findings
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.control.bench_calibration import BenchCalibration
from station.lab.config import load_lab

START = np.array([0.0, math.pi / 2, -0.100])
SEED = 5
PROVENANCE = Provenance("tubes", "2026-01-01T00:00:00+00:00", "a lab", SEED, 100.0, True)


@pytest.fixture(scope="module")
def subject() -> PlanSubject:
    return PlanSubject.of(load_robot("paper"), START)


@pytest.fixture(scope="module")
def bench(subject) -> StaticLab:
    return StaticLab(subject, load_lab("uncalibrated", subject.file), SEED)


@pytest.fixture(scope="module")
def found(subject, bench) -> procedures.TubesResult:
    return run_static(procedures.tubes(subject, procedures.Effort()), bench)


@pytest.fixture(scope="module")
def folder(subject, found, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("calibration")
    write_all(path, found, subject, PROVENANCE)
    return path


def test_calibrated_tubes_are_within_the_documented_bounds_of_the_true_ones(bench, found):
    for true, new in zip(bench.true_robot.tubes, found.calibration.robot.tubes, strict=True):
        assert new.bending_stiffness == pytest.approx(true.bending_stiffness, rel=0.02)
        bent, fitted = (math.hypot(*tube.sections[1].curvature) for tube in (true, new))
        assert fitted == pytest.approx(bent, rel=0.01)
        assert new.poisson_ratio == pytest.approx(0.35, abs=0.03)


def test_targets_on_the_path_of_fig10_are_registered_to_a_tenth_of_a_millimetre(bench, found):
    rod, frames = ExactRod(bench.true_robot), found.calibration.frames
    errors = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 12):
        joints = START + np.array([0.1, 0.35, 0.010]) * math.sin(angle)
        tip = rod.solve(bench.hidden.joints(joints), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])).tip
        errors.append(np.linalg.norm(frames.registration.apply(bench.reported_position(tip)) - tip))
    assert np.mean(errors) < 0.1e-3


def test_held_out_loaded_poses_are_predicted_at_least_four_times_better(found):
    assert found.held_out_believed.mean() > 4.0 * found.held_out_loaded.after.mean()
    assert found.held_out_loaded.after.mean() < 0.2e-3


def test_tubes_are_calibrated_without_force_sensors_from_known_weights(subject, tmp_path):
    alone = replace(subject, senses=False)
    bench = StaticLab(alone, load_lab("uncalibrated", subject.file), SEED)
    result = run_static(procedures.tubes(alone, procedures.Effort()), bench)
    for true, new in zip(bench.true_robot.tubes, result.calibration.robot.tubes, strict=True):
        assert new.bending_stiffness == pytest.approx(true.bending_stiffness, rel=0.02)
    assert result.held_out_loaded.after.mean() < 0.2e-3
    numbers = write_all(tmp_path, result, alone, PROVENANCE)
    assert numbers["files"] == ["registration.toml", "robot.toml", "described.toml"]
    BenchCalibration.load(tmp_path, subject.file)


def test_findings_report_a_calibration_without_improvement(found):
    assert not any("no improvement" in sentence for sentence in findings(found))
    poor = found._replace(held_out_believed=1.2 * found.held_out_loaded.after)
    assert any("almost no improvement" in sentence for sentence in findings(poor))


def test_axis_of_the_coil_is_found_and_read_back(subject, bench, found, folder):
    assert found.axis is not None
    assert math.degrees(math.acos(bench.hidden.coil_axis[2])) == pytest.approx(3.0, abs=0.01)
    assert math.degrees(math.acos(min(float(found.axis.direction @ bench.hidden.coil_axis), 1.0))) < 0.3
    axis = BenchCalibration.load(folder, subject.file).corrections.axis
    np.testing.assert_allclose(axis, found.axis.direction, rtol=0, atol=1e-8)


def test_impossible_axis_of_the_coil_is_refused_with_the_file(subject, folder, tmp_path):
    text = (folder / "registration.toml").read_text(encoding="utf-8")
    lines = ["axis = [0.0, 0.0, -1.0]" if line.startswith("axis = ") else line for line in text.splitlines()]
    (tmp_path / "registration.toml").write_text("\n".join(lines), encoding="utf-8")

    with pytest.raises(ConfigError, match=r"registration\.toml: axis .* less than 90 deg from the tip's"):
        BenchCalibration.load(tmp_path, subject.file)


def test_known_weights_are_measured_correctly(found):
    for known, check in found.checks:
        assert check.magnitude == pytest.approx(known, rel=0.005)
        assert math.degrees(check.angle) < 0.5


def test_contacts_on_the_shaft_are_found(subject, bench, found):
    model, random, errors = Statics(found.calibration.robot), np.random.default_rng(8), []
    for _ in range(6):
        joints = np.r_[random.uniform(-2.0, 2.0, 2), random.uniform(-0.11, -0.03)]
        place, direction = random.uniform(0.05, 0.28 + joints[2]), random.standard_normal(3)
        free = found.sensors.load(subject.robot, bench.measure(joints, 0.0))
        measurement = bench.measure(joints, 0.3, place, direction / np.linalg.norm(direction))
        load = found.sensors.load(subject.robot, measurement)
        load = load._replace(force=load.force - free.force, moment=load.moment - free.moment)
        contact = locate_contact(model, joints, load, Noise(force=3e-3, moment=0.2e-3))
        assert contact is not None
        if contact.located:
            errors.append(abs(contact.arc_length - place))
    assert len(errors) >= 4
    assert np.median(errors) < 10e-3


def test_calibration_files_are_read_back_unchanged(subject, found, folder):
    known = BenchCalibration.load(folder, subject.file)

    for written, tube in zip(known.robot.robot().tubes, found.calibration.robot.tubes, strict=True):
        assert written.bending_stiffness == pytest.approx(tube.bending_stiffness, rel=1e-7)
        assert written.sections[1].curvature == pytest.approx(tube.sections[1].curvature, rel=1e-6, abs=1e-8)
        assert written.sections[0].length == pytest.approx(tube.sections[0].length, rel=1e-7)
    assert known.robot.joints == subject.file.joints
    np.testing.assert_allclose(known.corrections.coil, found.calibration.frames.coil, rtol=1e-7)
    np.testing.assert_allclose(known.corrections.sensors.mounting, found.sensors.sensors.mounting, rtol=0, atol=1e-8)
    assert known.registration is not None
    point = np.array([10.0, -20.0, -300.0])  # position of a coil in the generator's frame [mm]
    from station.lab.aurora_coil import GENERATOR_POSE

    expected = found.calibration.frames.registration.apply(GENERATOR_POSE.apply(1e-3 * np.array(point)))
    np.testing.assert_allclose(known.registration.apply(1e-3 * np.array(point)), expected, rtol=0, atol=1e-8)


def test_calibrated_robot_file_has_provenance_and_intervals(folder):
    text = (folder / "robot.toml").read_text(encoding="utf-8")

    assert "calibrate tubes" in tomllib.loads(text)["source"]
    assert "2026-01-01" in tomllib.loads(text)["source"]
    assert text.count("(95 %); described") >= 6


def test_calibration_report_contains_its_figures_and_loads_no_other_files(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")

    assert page.count("data:image/svg+xml;base64,") == 3
    assert "simulated" in page
    assert 'src="http' not in page
    assert 'href="http' not in page
    numbers = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert numbers["visits"] == len(json.loads((folder / "visits.json").read_text(encoding="utf-8"))) == 98


def test_calibration_of_another_robot_is_refused(subject, folder):
    other = subject.file.model_copy(update={"name": "another"})

    with pytest.raises(ConfigError, match="made for robot 'paper', but the robot is 'another'"):
        BenchCalibration.load(folder, other)


def test_empty_calibration_folder_is_refused(subject, tmp_path):
    with pytest.raises(ConfigError, match=r"none of registration\.toml, sensors\.toml, .* and cameras\.toml"):
        BenchCalibration.load(tmp_path, subject.file)


def test_procedure_tracker_reports_that_the_tubes_differ(subject):
    bench = StaticLab(subject, load_lab("uncalibrated", subject.file), 1)

    result = run_static(procedures.tracker(subject, procedures.Effort(unloaded=16)), bench)

    assert result.registration.fit.variance_factor > 9.0
    assert result.registration.rms > 0.2e-3


def test_procedure_axes_finds_reversed_axes(subject):
    mirrored = ("outer_rotation", "inner_translation")
    lab = load_lab("uncalibrated", subject.file)
    lab = lab.model_copy(update={"hidden": lab.hidden.model_copy(update={"mirrored": mirrored})})

    result = run_static(commission.axes(subject), StaticLab(subject, lab, 2))

    names = [joint.name for joint in subject.robot.joints]
    assert [name for name, sign in zip(names, result.signs.signs, strict=True) if sign < 0.0] == list(mirrored)


def test_controller_of_an_experiment_uses_the_calibration(folder, found):
    from station.experiments.experiment import load_experiment

    case = load_experiment("fig6", {"calibration": str(folder)}).cases[0]

    tube = case.controller.statics.robot.tubes[0]
    assert tube.bending_stiffness == pytest.approx(found.calibration.robot.tubes[0].bending_stiffness, rel=1e-7)
    assert case.robot.tubes[0].bending_stiffness == 0.0413  # the lab's plant is not calibrated
    assert case.controller.corrections is not None
    assert case.registration is not None


def test_station_file_selects_the_calibration(folder, found, tmp_path):
    from station.config.controllers import DEFAULT_CONTROLLER
    from station.devices.config import BenchFile
    from station.service.station_file import load_station

    path = tmp_path / "bench.toml"
    path.write_text(f'lab = "uncalibrated"\ncalibration = "{folder}"\n', encoding="utf-8")
    bench = load_station(path).bench()

    tube = bench.controlled(DEFAULT_CONTROLLER).statics.robot.tubes[0]
    assert tube.bending_stiffness == pytest.approx(found.calibration.robot.tubes[0].bending_stiffness, rel=1e-7)
    assert bench.robot.tubes[0].bending_stiffness == 0.0413
    devices = BenchFile.model_construct(stages={}, tracker={"driver": "aurora", "port": "x"}, sensors={})
    mount = bench.registered(devices).tracker["mount"]
    assert bench.calibration is not None
    np.testing.assert_allclose(mount["position"], bench.calibration.registration.position)
