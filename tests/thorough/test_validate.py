"""`calibrate tubes --from` and `validate --fit friction` on poses of an exact rod."""

import csv
import json
import math

import numpy as np
import pytest

from core.calibration.quantities import quantities, with_changes
from core.model.cosserat import ExactRod
from station.calibration.results import Results
from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from tests.harness.exact_poses import TRACKER, written_poses

HALF_LAG_RAD = 0.08


def numbers(done) -> dict:
    assert done.status == 0, done.err
    return json.loads(done.out)


def test_three_tubes_under_load_are_fitted_and_accepted_by_a_station(call, tmp_path):
    path = written_poses(tmp_path, "three_tubes", force=0.02, curvature=0.04)
    result = numbers(call("calibrate", "tubes", "--robot", "three_tubes", "--from", str(path), "--json"))

    assert result["errors_mm"]["frames"]["mean"] > 5.0 * result["errors_mm"]["tubes"]["mean"]
    assert result["errors_mm"]["tubes"]["mean"] < 0.06
    found = BenchCalibration.load(tmp_path / result["folder"], load_robot("three_tubes"))
    for tube, described in zip(found.robot.tubes, load_robot("three_tubes").tubes, strict=True):
        ratio = math.hypot(*tube.sections[1].curvature) / math.hypot(*described.sections[1].curvature)
        assert ratio == pytest.approx(1.04, abs=0.01)
    (kept,) = Results(tmp_path / "calibrations").all()
    assert "--calibration" in kept.use.options
    assert "registration.toml" in kept.files
    back = TRACKER.inverse()
    np.testing.assert_allclose(found.registration.position, back.position, atol=0.5e-3)
    np.testing.assert_allclose(found.corrections.coil, [0.0, 1e-3, 8e-3], atol=0.5e-3)


@pytest.fixture
def flush_with_friction(tmp_path):
    """Write poses of an exact rod whose two tubes often end flush; friction winds up the inner tube."""
    random, robot = np.random.default_rng(1), load_robot("nylon").robot()
    what = [quantity for quantity in quantities(robot) if quantity.kind == "curvature"]
    exact, path = ExactRod(with_changes(robot, what, np.array([0.04, -0.03]))), tmp_path / "flush.csv"
    wound, relative = 0.0, None
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["time", *robot.joint_names, "tip_x", "tip_y", "tip_z"])
        for number in range(40):
            outer, inner = random.uniform(-1.0, 1.0, 2)
            slide = random.uniform(-0.1, -0.04)
            flush = slide + robot.tubes[1].length - robot.tubes[0].length
            # In a third of the poses the tubes end flush, except for the rounding of the joint positions to 0.1 mm.
            drawn = round(flush - 0.05e-3, 4) if number % 3 == 0 else flush + random.uniform(0.0, 0.03)
            turn = 0.0 if relative is None else inner - outer - relative
            relative = inner - outer
            for _ in range(1000):  # integrate Dahl's friction law in small steps
                wound += 1e-3 * (turn - abs(turn) * wound / HALF_LAG_RAD)
            rod = exact.solve(np.array([outer, slide, inner - wound, max(drawn, flush)]), np.zeros(6))
            tip = TRACKER.apply(rod.tip + rod.rotation @ [0.0, 1e-3, 8e-3]) + 2e-5 * random.standard_normal(3)
            writer.writerow([float(number), outer, slide, inner, drawn, *tip])
    return path


def test_fit_of_flush_tubes_with_friction_predicts_other_poses(call, flush_with_friction):
    result = numbers(call("validate", "nylon", str(flush_with_friction), "--fit", "friction", "--json"))
    tubes, friction = result["unseen_mm"]["tubes"]["tested"], result["unseen_mm"]["friction"]["tested"]

    assert result["used"] == 40
    assert any("were read as flush" in sentence for sentence in result["findings"])
    half_lag = result["parameters"]["inner half lag"]
    assert half_lag["standard_deviation"] < 2.5e-3
    assert half_lag["value"] == pytest.approx(HALF_LAG_RAD, abs=3.0 * half_lag["standard_deviation"])
    assert friction["median"] < 0.06 < 0.15 < tubes["mean"]
    assert "inner torsional_stiffness" in result["parameters"]
    assert "inner curve_start" in result["parameters"]
