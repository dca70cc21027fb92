"""`ctr-station validate` and `calibrate tubes --from`: their results, their files and their error messages."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas
import pytest

from station.config.robots import load_robot
from station.control.bench_calibration import BenchCalibration
from station.control.residual_file import read_residual, write_residual
from tests.harness.exact_poses import written_poses

MEASURED = Path(__file__).parents[3] / "measured_nylon.csv"


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

    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    for name, chosen in (("one", lines[3::2]), ("two", lines[4::2])):
        (tmp_path / f"{name}.csv").write_text("\n".join([lines[2], *chosen]) + "\n", encoding="utf-8")
    half = numbers(call("validate", "nylon", "one.csv", "--test", "two.csv", "--json"))
    assert half["used"] == 13
    assert half["unseen_mm"]["frames"]["tested"] == result["unseen_mm"]["frames"]["tested"]


def test_validate_detects_joint_lag_by_direction_and_fits_it_on_request(call, tmp_path):
    path = written_poses(tmp_path, "paper", play=(0.06, 0.8e-3))
    without = numbers(call("validate", "paper", str(path), "--json"))
    fitted = numbers(call("validate", "paper", str(path), "--hysteresis", "--json"))

    assert any("--hysteresis fits a lag" in sentence for sentence in without["findings"])
    assert {row["where"] for row in without["by_direction"]} == {"rising", "falling"}
    assert fitted["errors_mm"]["frames"]["median"] < 0.3 * without["errors_mm"]["frames"]["median"]
    for name, play, unit in (("outer_rotation", 0.06, 1e-2), ("inner_rotation", 0.06, 1e-2)):
        assert fitted["parameters"][f"{name} play"]["value"] == pytest.approx(play, abs=unit)
    assert fitted["parameters"]["inner_translation play"]["value"] == pytest.approx(0.8e-3, abs=0.15e-3)


def test_a_learned_residual_predicts_held_out_trajectories_and_a_station_reads_its_file(call, tmp_path):
    path = written_poses(tmp_path, "paper", poses=120, play=(0.2, 0.0), force=0.02)
    result = numbers(call("calibrate", "residual", "--robot", "paper", "--from", str(path), "--json"))
    folder = tmp_path / result["folder"]
    found = BenchCalibration.load(folder, load_robot("paper")).residual

    unseen = result["unseen_mm"]
    assert unseen["residual"]["tested"]["mean"] < 0.75 * unseen["tubes"]["tested"]["mean"]
    assert result["learned"]["corrected_mm"] < 1.02 * result["learned"]["model_mm"]
    assert found is not None
    assert found.strength == result["learned"]["strength"]
    assert write_residual(folder / "again.toml", load_robot("paper").robot(), found, 120, "").is_file()
    again = read_residual(folder / "again.toml", load_robot("paper").robot())
    np.testing.assert_allclose(again.packed(), found.packed(), rtol=1e-12)
    assert "What the residual explains" in (folder / "report.html").read_text(encoding="utf-8")

    data = call("export", result["folder"], "--dataset", "--licence", "CC0")
    assert data.status == 0, data.err
    frame = pandas.read_parquet(folder / "dataset.parquet")
    rows = list(csv.DictReader((folder / "errors.csv").read_text(encoding="utf-8").splitlines()))
    assert frame["tip_x"].tolist() == [float(row["tip_x"]) for row in rows]
    assert set(frame.groupby("trajectory")["split"].nunique()) == {1}
    assert "licence: CC0" in (folder / "dataset.md").read_text(encoding="utf-8")
    same = numbers(call("validate", "paper", str(folder / "dataset.parquet"), "--json"))
    plain = numbers(call("validate", "paper", str(path), "--json"))
    assert same["errors_mm"]["frames"]["mean"] == pytest.approx(plain["errors_mm"]["frames"]["mean"], rel=1e-3)


def test_validate_lists_and_skips_unusable_rows(call, tmp_path):
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[4], "nan")
    lines[7] = "0,-0.02,0.1,-0.25,0.02,0.05,0.11"
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = call("validate", "nylon", "poses.csv")

    assert done.status == 0
    assert "line 6 left out: tip_x: no finite number" in done.out
    assert "line 8 left out: inner_translation -0.25 m is outside -0.209 ... 0 m" in done.out
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
