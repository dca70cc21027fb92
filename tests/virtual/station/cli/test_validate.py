"""`ctr-station validate` and `calibrate tubes --from`: numbers, files, and a word of help for what goes wrong."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from core.calibration.quantities import changed, quantities
from core.calibration.rigid import Rigid, rotation_of
from core.model.cosserat import ExactRod
from station.calibration.results import Results
from station.config.robots import load_robot
from station.control.known_calibration import Calibration

MEASURED = Path(__file__).parents[3] / "measured_nylon.csv"
TRACKER = Rigid(rotation_of(np.array([1.0, -2.0, 0.5])), np.array([0.3, 0.2, -0.1]))


@pytest.fixture
def generated(tmp_path):
    """Make a file of poses of the exact rod whose tubes are curved otherwise, along a walk, behind the joints' ways."""

    def generated(name: str, *, poses=60, force=0.0, play=(0.0, 0.0), curvature=0.0, timed=True) -> Path:
        file, random = load_robot(name), np.random.default_rng(3)
        robot, limits = file.robot(), file.limits().joints
        what = [quantity for quantity in quantities(robot) if quantity.kind == "curvature"]
        exact = ExactRod(changed(robot, what, np.full(len(what), curvature)))
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
                joints = moved if robot.stands(moved) else joints
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


def test_the_nylon_robot_with_its_published_tubes(call, tmp_path):
    said = numbers(call("validate", "nylon", str(MEASURED), "--json"))

    assert said["used"] == 25
    assert said["errors_mm"]["frames"]["mean"] < 0.5
    assert said["errors_mm"]["none"]["mean"] > 50.0  # the tracker stood elsewhere
    assert said["unseen_mm"]["frames"]["tested"]["poses"] == 12
    assert said["unseen_mm"]["frames"]["tested"]["mean"] < 0.7
    folder = tmp_path / said["folder"]
    assert {path.name for path in folder.iterdir()} == {"report.html", "report.json", "errors.csv"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == 4
    rows = list(csv.DictReader((folder / "errors.csv").read_text(encoding="utf-8").splitlines()))
    mean = np.mean([float(row["error"]) for row in rows])
    assert mean == pytest.approx(1e-3 * said["errors_mm"]["frames"]["mean"], rel=1e-6)
    assert [int(row["line"]) for row in rows] == list(range(4, 29))


def test_other_poses_test_what_was_fitted(call, tmp_path):
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    for name, rows in (("one", lines[3::2]), ("two", lines[4::2])):
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[2], *rows]) + "\n", encoding="utf-8")
    said = numbers(call("validate", "nylon", "one.csv", "--test", "two.csv", "--json"))
    whole = numbers(call("validate", "nylon", str(MEASURED), "--json"))

    assert said["used"] == 13
    assert said["unseen_mm"]["frames"]["tested"] == whole["unseen_mm"]["frames"]["tested"]


def test_three_tubes_under_load_are_found_and_a_station_takes_them(call, generated, tmp_path):
    path = generated("three_tubes", force=0.02, curvature=0.04)
    said = numbers(call("calibrate", "tubes", "--robot", "three_tubes", "--from", str(path), "--json"))

    assert said["errors_mm"]["frames"]["mean"] > 5.0 * said["errors_mm"]["tubes"]["mean"]
    assert said["errors_mm"]["tubes"]["mean"] < 0.06
    found = Calibration.load(tmp_path / said["folder"], load_robot("three_tubes"))
    for tube, described in zip(found.robot.tubes, load_robot("three_tubes").tubes, strict=True):
        ratio = math.hypot(*tube.sections[1].curvature) / math.hypot(*described.sections[1].curvature)
        assert ratio == pytest.approx(1.04, abs=0.01)
    (kept,) = Results(tmp_path / "calibrations").all()
    assert "--calibration" in kept.use.options
    assert "registration.toml" in kept.files
    back = TRACKER.inverse()
    np.testing.assert_allclose(found.registration.position, back.position, atol=0.5e-3)
    np.testing.assert_allclose(found.corrections.coil, [0.0, 1e-3, 8e-3], atol=0.5e-3)


def test_a_lag_is_seen_by_direction_and_fitted_when_asked_for(call, generated):
    path = generated("paper", play=(0.06, 0.8e-3))
    without = numbers(call("validate", "paper", str(path), "--json"))
    fitted = numbers(call("validate", "paper", str(path), "--hysteresis", "--json"))

    assert any("--hysteresis fits a lag" in sentence for sentence in without["findings"])
    assert {row["where"] for row in without["by_direction"]} == {"rising", "falling"}
    assert fitted["errors_mm"]["frames"]["median"] < 0.3 * without["errors_mm"]["frames"]["median"]
    for name, play, unit in (("outer_rotation", 0.06, 1e-2), ("inner_rotation", 0.06, 1e-2)):
        assert fitted["parameters"][f"{name} play"]["value"] == pytest.approx(play, abs=unit)
    assert fitted["parameters"]["inner_translation play"]["value"] == pytest.approx(0.8e-3, abs=0.15e-3)


def test_what_is_of_no_use_is_listed_and_the_rest_goes_on(call, tmp_path):
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[4], "nan")
    lines[7] = "0,-0.02,0.1,-0.161,0.02,0.05,0.11"
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = call("validate", "nylon", "poses.csv")

    assert done.status == 0
    assert "line 6 left out: tip_x: no finite number" in done.out
    assert "line 8 left out: tube 'inner' ends at 50 mm, not beyond" in done.out
    assert "23 poses, 2 left out" in done.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["validate", "nylon", "gone.csv"], ["gone.csv: cannot be read"]),
        (["validate", "hydra", str(MEASURED)], ["'hydra' is not one of the robots", "nylon"]),
        (["validate", "paper", str(MEASURED)], ["unknown column 'outer_translation'", "inner_translation"]),
        (["validate", "nylon", str(MEASURED), "--hysteresis"], ["add a column 'time'"]),
        (["validate", "nylon", str(MEASURED), "--fit", "none", "--hysteresis"], ["column 'time'"]),
        (["calibrate", "tracker", "--from", str(MEASURED)], ["goes with 'calibrate tubes'"]),
        (["calibrate", "tubes", "--hysteresis"], ["--hysteresis goes with --from"]),
    ],
)  # fmt: skip
def test_a_wrong_request_is_answered_with_what_to_do(call, tmp_path, arguments, words):
    done = call(*arguments)
    assert done.status == 2
    assert done.out == ""
    for word in words:
        assert word in done.err
    assert len(done.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
