"""The command line as a process: its output, its files on disk and its exit status."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_outcome import RunOutcome
from tests.harness.waiting import NET

GOOD = b'{"joints": {"outer_rotation": 0, "inner_rotation": 1.57, "inner_translation": -0.1}, "force": [0.2, 0, 0]}\n'
TWO_CASES = "[cases.one]\n[cases.two.controller]\nfeedforward = true\n[paper.one]\nmax_abs_error_mm = { x = 7.9 }\n"


def folders(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir()) if out.exists() else []


def test_run_prints_one_json_object_and_writes_a_complete_folder(command_line, write, short, tmp_path):
    path = write(short + TWO_CASES)
    done = command_line("run", str(path), "--seed", "7", "--out", "out", "--json")

    assert done.returncode == 0
    assert done.stderr == b""
    assert len(done.stdout.splitlines()) == 1
    summary = json.loads(done.stdout)
    assert {"experiment", "seed", "completed", "simulated_s", "wall_s", "recording", "cases"} <= set(summary)
    assert (summary["experiment"], summary["seed"], summary["completed"]) == ("own", 7, True)
    assert (
        6.0 < summary["simulated_s"] < 12.0
    )  # two motions of 1 s each, the rest before each motion, and the connecting of the devices
    assert list(summary["cases"]) == ["one", "two"]
    for case in summary["cases"].values():
        for key in ("max_abs_error_mm", "rms_error_mm", "true_max_abs_error_mm", "true_rms_error_mm"):
            assert np.shape(case[key]) == (3,)
            assert np.isfinite(case[key]).all()
        assert 0.0 < case["true_mean_error_mm"] < 1.0  # small error, because the robot is at rest without load
        assert 0.0 < case["mean_error_mm"] < 1.0

    assert folders(tmp_path / "out") == [Path(summary["recording"]).name]
    folder = tmp_path / summary["recording"]
    assert folders(folder) == ["experiment.toml", "one.mcap", "summary.json", "two.mcap"]
    kept = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert kept == summary | {key: kept[key] for key in ("title", "started", "label", "cause")}
    assert kept["label"] == "complete"
    assert (folder / "experiment.toml").read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
    recorded = read_case(folder / "one.mcap")
    columns = [channel.column for channel in recorded.channels]
    assert columns[0] == "time [s]"
    assert {"joints.outer_rotation [rad]", "force.x [N]", "tip_true.z [m]"} <= set(columns)
    assert recorded.rows.shape == (500, len(recorded.channels))


def test_full_disk_ends_the_command_run_and_keeps_the_written_part(environment, write, short, tmp_path):
    path = write(
        short.replace("duration = 1.0", "duration = 8.0")
    )  # the recording would have about 2.4 MB, more than the limit of 1 MiB per file
    command = f"ulimit -f 1024; exec '{sys.executable}' -m station run '{path}' --out out --json"
    done = subprocess.run(["bash", "-c", command], capture_output=True, cwd=tmp_path, env=environment, timeout=NET)

    # The end of the last complete chunk determines whether the disk also has room for the end of the file.
    assert done.returncode in (1, 2), done.stderr
    if done.returncode == 1:
        cause = json.loads(done.stdout)["cases"]["own"]["cause"]
        assert "the recording cannot be continued: File too large" in cause
    else:
        assert b"own.mcap.full is not finished; the next start recovers it" in done.stderr
        recover(tmp_path / "out")
    (folder,) = (tmp_path / "out").iterdir()
    assert json.loads((folder / "summary.json").read_text(encoding="utf-8"))["label"] == "incomplete"
    recorded = read_case(folder / "own.mcap")
    assert recorded.label is RunOutcome.INCOMPLETE
    assert 500 <= len(recorded.rows) < 4000


def test_ctrl_c_ends_the_command_run_without_a_partial_result(environment, write, short, tmp_path):
    path = write(short.replace("duration = 1.0", "duration = 600.0"))
    out = tmp_path / "out"
    run = subprocess.Popen(
        [sys.executable, "-m", "station", "run", str(path), "--realtime", "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, env=environment,
    )  # fmt: skip
    with run:
        give_up = time.monotonic() + 60.0
        while not folders(out) and run.poll() is None and time.monotonic() < give_up:
            time.sleep(0.02)
        time.sleep(1.0)
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=NET)

    assert run.returncode in (1, 130)
    assert b"Traceback" not in err
    for name in folders(out):
        assert not name.endswith(".partial")
        summary = json.loads((out / name / "summary.json").read_text(encoding="utf-8"))
        assert summary["completed"] is False
        assert summary["cases"]["own"]["cause"] == "interrupted"


@pytest.mark.parametrize("start", [("-m", "station"), ("-c", "from web.ctr_station import main; main()")])
def test_ctrl_c_during_imports_is_reported_in_one_line(environment, tmp_path, start):
    interrupting = tmp_path / "numpy"
    interrupting.mkdir()
    (interrupting / "__init__.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n", encoding="utf-8"
    )
    environment = {**environment, "PYTHONPATH": f"{tmp_path}{os.pathsep}{environment['PYTHONPATH']}"}
    command = [sys.executable, *start, "run", "fig10"]
    done = subprocess.run(command, capture_output=True, cwd=tmp_path, env=environment, timeout=NET, check=False)
    assert (done.returncode, done.stderr) == (130, b"ctr-station: interrupted\n")


def test_solve_answers_line_by_line_and_ends_with_its_input(command_line):
    done = command_line("solve", stdin=GOOD + b'\xff\xfe\n{"joints": 3}\n' + GOOD)
    first, bytes_, bad, last = (json.loads(line) for line in done.stdout.splitlines())

    assert done.returncode == 0
    assert done.stderr == b""
    assert first == last
    assert set(first) == {
        "tip", "ends", "direction", "joints", "jacobian", "compliance", "iterations", "stability", "integrator",
        "sublink",
    }  # fmt: skip
    assert list(bytes_) == list(bad) == ["error"]


def test_solve_accepts_a_closed_input(environment, tmp_path, command_line):
    assert command_line("solve").stdout == b""
    command = f"exec '{sys.executable}' -m station solve <&-"
    done = subprocess.run(["bash", "-c", command], capture_output=True, cwd=tmp_path, env=environment, timeout=NET)

    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_solve_ends_without_an_error_when_its_reader_closes(environment, tmp_path):
    reader, writer = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-m", "station", "solve"],
        stdin=subprocess.PIPE, stdout=writer, stderr=subprocess.PIPE, cwd=tmp_path, env=environment,
    ) as solve:  # fmt: skip
        os.close(writer)
        os.close(reader)
        _, err = solve.communicate(GOOD * 3, timeout=NET)

    assert solve.returncode == 1
    assert err == b""
