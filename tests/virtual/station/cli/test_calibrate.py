"""Results and output files of `ctr-station calibrate`."""

import json


def test_calibrate_writes_a_folder_and_prints_its_path(call, tmp_path):
    done = call("calibrate", "tracker", "--still", "--seed", "3", "--effort", "0.5", "--out", "found", "--json")

    assert done.status == 0, done.err
    (folder,) = (tmp_path / "found").iterdir()
    assert {path.name for path in folder.iterdir()} == {
        "described.toml",
        "registration.toml",
        "report.html",
        "report.json",
        "visits.json",
    }
    assert folder.name in done.out


def test_calibrate_axes_detects_a_mirrored_stage(call, write):
    lab = write('[hidden]\nmirrored = ["inner_rotation"]\n', "mirrored")

    done = call("calibrate", "axes", "--lab", str(lab), "--still", "--out", "found", "--json")

    assert done.status == 0, done.err
    assert json.loads(done.out)["signs"] == {"outer_rotation": 1.0, "inner_rotation": -1.0, "inner_translation": 1.0}
