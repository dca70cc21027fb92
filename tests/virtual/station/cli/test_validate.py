"""`ctr-station validate` and `calibrate tubes --from`: their results, their files and their error messages."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from core.calibration.quantities import quantities, with_changes
from core.calibration.rigid_transform import RigidTransform, rotation_from_vector
from core.model.cosserat import ExactRod
from station.calibration.results import Results
from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration

MEASURED = Path(__file__).parents[3] / "measured_nylon.csv"
TRACKER = RigidTransform(rotation_from_vector(np.array([1.0, -2.0, 0.5])), np.array([0.3, 0.2, -0.1]))
HALF_LAG_RAD = 0.08


@pytest.fixture
def generated(tmp_path):
    """Write poses of an exact rod with other tube curvatures, along a random walk, with lagging joints."""

    def generated(name: str, *, poses=60, force=0.0, play=(0.0, 0.0), curvature=0.0, timed=True) -> Path:
        file, random = load_robot(name), np.random.default_rng(3)
        robot, limits = file.robot(), file.limits().joints
        what = [quantity for quantity in quantities(robot) if quantity.kind == "curvature"]
        exact = ExactRod(with_changes(robot, what, np.full(len(what), curvature)))
        lower = np.array([max(limit.lower, -1.2) for limit in limits])
        upper = np.array([min(limit.upper, 1.2) for limit in limits])
        width = np.array([play[limit.unit == "m"] for limit in limits])
        joints = behind = 0.5 * (lower + upper)
        path = tmp_path / f"{name}.csv"
        with path.open("w", newline="") as out:
            writer = csv.writer(out)
            forces = ("force_x", "force_y", "force_z")
            writer.writerow([*(["time"] if timed else []), *robot.joint_names, "tip_x", "tip_y", "tip_z", *forces])
            for number in range(poses):
                moved = np.clip(joints + 0.3 * (upper - lower) * random.uniform(-1.0, 1.0, len(limits)), lower, upper)
                joints = moved if robot.is_valid_pose(moved) else joints
                behind = np.clip(behind, joints - 0.5 * width, joints + 0.5 * width)
                load = force * random.standard_normal(3)
                rod = exact.solve(behind, np.r_[load, 0.0, 0.0, 0.0])
                tip = TRACKER.apply(rod.tip + rod.rotation @ [0.0, 1e-3, 8e-3]) + 2e-5 * random.standard_normal(3)
                writer.writerow([*([float(number)] if timed else []), *joints, *tip, *load])
        return path

    return generated


def numbers(done) -> dict:
    assert done.status == 0, done.err
    return json.loads(done.out)


def test_published_tubes_of_the_nylon_robot_match_the_measured_poses(call, tmp_path):
    result = numbers(call("validate", "nylon", str(MEASURED), "--json"))

    assert result["used"] == 25
    assert result["errors_mm"]["frames"]["mean"] < 0.5
    assert (
        result["errors_mm"]["none"]["mean"] > 50.0
    )  # the tracker was at another position, so the poses do not match without a registration
    assert result["unseen_mm"]["frames"]["tested"]["poses"] == 12
    assert result["unseen_mm"]["frames"]["tested"]["mean"] < 0.7
    folder = tmp_path / result["folder"]
    assert {path.name for path in folder.iterdir()} == {"report.html", "report.json", "errors.csv"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == 4
    rows = list(csv.DictReader((folder / "errors.csv").read_text(encoding="utf-8").splitlines()))
    mean = np.mean([float(row["error"]) for row in rows])
    assert mean == pytest.approx(1e-3 * result["errors_mm"]["frames"]["mean"], rel=1e-6)
    assert [int(row["line"]) for row in rows] == list(range(4, 29))


def test_validate_tests_its_fit_with_the_poses_of_another_file(call, tmp_path):
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    for name, rows in (("one", lines[3::2]), ("two", lines[4::2])):
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[2], *rows]) + "\n", encoding="utf-8")
    result = numbers(call("validate", "nylon", "one.csv", "--test", "two.csv", "--json"))
    whole = numbers(call("validate", "nylon", str(MEASURED), "--json"))

    assert result["used"] == 13
    assert result["unseen_mm"]["frames"]["tested"] == whole["unseen_mm"]["frames"]["tested"]


def test_three_tubes_under_load_are_fitted_and_accepted_by_a_station(call, generated, tmp_path):
    path = generated("three_tubes", force=0.02, curvature=0.04)
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


def test_validate_classifies_the_residual_as_friction_or_smooth(call, flush_with_friction):
    wound = numbers(call("validate", "nylon", str(flush_with_friction), "--fit", "frames", "--json"))
    nylon = numbers(call("validate", "nylon", str(MEASURED), "--fit", "frames", "--json"))

    assert wound["residual"]["kind"] == "friction"
    assert wound["residual"]["learned_mean_mm"] < wound["residual"]["mean_mm"]
    assert any("--fit friction" in sentence for sentence in wound["findings"])
    assert nylon["residual"]["kind"] == "smooth"
    assert nylon["residual"]["joints_and_motion"] is None


def test_validate_detects_joint_lag_by_direction_and_fits_it_on_request(call, generated):
    path = generated("paper", play=(0.06, 0.8e-3))
    without = numbers(call("validate", "paper", str(path), "--json"))
    fitted = numbers(call("validate", "paper", str(path), "--hysteresis", "--json"))

    assert any("--hysteresis fits a lag" in sentence for sentence in without["findings"])
    assert {row["where"] for row in without["by_direction"]} == {"rising", "falling"}
    assert fitted["errors_mm"]["frames"]["median"] < 0.3 * without["errors_mm"]["frames"]["median"]
    for name, play, unit in (("outer_rotation", 0.06, 1e-2), ("inner_rotation", 0.06, 1e-2)):
        assert fitted["parameters"][f"{name} play"]["value"] == pytest.approx(play, abs=unit)
    assert fitted["parameters"]["inner_translation play"]["value"] == pytest.approx(0.8e-3, abs=0.15e-3)


def test_validate_lists_and_skips_unusable_rows(call, tmp_path):
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[4], "nan")
    lines[7] = "0,-0.02,0.1,-0.161,0.02,0.05,0.11"
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = call("validate", "nylon", "poses.csv")

    assert done.status == 0
    assert "line 6 left out: tip_x: no finite number" in done.out
    assert "line 8 left out: tube 'inner' ends at 50 mm, but must end beyond" in done.out
    assert "23 poses, 2 left out" in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["validate", "nylon", "gone.csv"], ["gone.csv: cannot be read"]),
        (["validate", "hydra", str(MEASURED)], ["'hydra' is not one of the robots", "nylon"]),
        (["validate", "paper", str(MEASURED)], ["unknown column 'outer_translation'", "inner_translation"]),
        (["validate", "nylon", str(MEASURED), "--hysteresis"], ["add a column 'time'"]),
        (["validate", "nylon", str(MEASURED), "--fit", "friction"], ["--fit friction needs the order"]),
        (["validate", "nylon", str(MEASURED), "--fit", "none", "--hysteresis"], ["column 'time'"]),
        (["calibrate", "tracker", "--from", str(MEASURED)], ["works with 'calibrate tubes'"]),
        (["calibrate", "tubes", "--hysteresis"], ["--hysteresis requires --from"]),
    ],
)  # fmt: skip
def test_validate_error_for_invalid_arguments_has_an_instruction(call, tmp_path, arguments, words):
    done = call(*arguments)
    assert done.status == 2
    assert done.out == ""
    for word in words:
        assert word in done.err
    assert len(done.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
