"""`ctr-station calibrate` as a process."""

import json
import os
import signal
import subprocess
import sys
import time


def test_ctrl_c_ends_the_command_and_leaves_nothing(tmp_path, environment):
    command = [sys.executable, "-m", "station", "calibrate", "tubes", "--realtime", "--out", "found"]
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        time.sleep(8.0)
        assert process.poll() is None, process.stderr.read()
        os.kill(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130
    assert b"interrupted" in said
    assert not (tmp_path / "found").exists()


def test_the_command_writes_its_folder_and_says_where(command_line, tmp_path):
    done = command_line("calibrate", "tracker", "--still", "--seed", "3", "--effort", "0.5", "--out", "found", "--json")

    assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "found").iterdir()
    assert {path.name for path in folder.iterdir()} == {
        "registration.toml",
        "report.html",
        "report.json",
        "visits.json",
    }
    assert folder.name in done.stdout.decode()


def test_the_axes_command_finds_a_mirrored_stage_on_the_wire(command_line, write, tmp_path):
    lab = write('[hidden]\nmirrored = ["inner_rotation"]\n', "mirrored")

    done = command_line("calibrate", "axes", "--lab", str(lab), "--out", "found", "--json")

    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["signs"] == {"outer_rotation": 1.0, "inner_rotation": -1.0, "inner_translation": 1.0}
