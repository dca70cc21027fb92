"""`ctr-station validate` as a separate process: output, files and errors."""

import json
from pathlib import Path

MEASURED = Path(__file__).parents[3] / "measured_nylon.csv"


def test_validate_prints_one_json_object_and_writes_its_files(command_line, tmp_path):
    done = command_line("validate", "nylon", str(MEASURED), "--fit", "tubes", "--json")

    assert done.returncode == 0, done.stderr
    assert done.stderr == b""
    numbers = json.loads(done.stdout)
    assert numbers["fit"] == "tubes"
    assert numbers["errors_mm"]["tubes"]["mean"] < numbers["errors_mm"]["frames"]["mean"] < 0.5
    assert any("outer bending stiffness" in reason for reason in numbers["not_asked_for"])
    assert (tmp_path / numbers["folder"] / "report.html").is_file()


def test_help_of_validate_names_the_columns(command_line):
    done = command_line("validate", "--help")
    assert done.returncode == 0
    for name in (b"tip_x", b"force_x", b"time", b"joints by"):
        assert name in done.stdout


def test_validate_of_angles_in_degrees_prints_one_line_of_error_and_writes_no_files(command_line, tmp_path):
    (tmp_path / "poses.csv").write_text(
        "outer_rotation,outer_translation,inner_rotation,inner_translation,tip_x,tip_y,tip_z\n"
        "0,-0.09121,-45,-0.151,0.02,0.05,0.1\n0,-0.09121,45,-0.151,0.02,0.06,0.1\n"
    )
    done = command_line("validate", "nylon", "poses.csv")

    assert done.returncode == 2
    assert b"are these degrees?" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["poses.csv"]
