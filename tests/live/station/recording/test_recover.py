"""Recovery of the folders of killed processes."""

import json
import os
import signal
import subprocess
import sys

import pytest

from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_folder import MARK_FILE, MARK_TEXT
from station.recording.run_outcome import RunOutcome
from station.recording.writer import PARTIAL_SUFFIX

#: Program that records one whole case, starts to record a second one, and waits until the test kills it.
RECORD = """
import sys, time
from pathlib import Path
import numpy as np
from station.recording.writer import CaseRecorder
from station.recording.run_folder import MARK_FILE, MARK_TEXT
from station.recording.run_outcome import RunOutcome
from station.recording.run_folder import RunFolder
from station.recording.writer import CaseWriter
from station.config.robots import load_robot
from station.control.telemetry import Channels

robot = load_robot("paper").robot()
channels = Channels(robot)
folder = RunFolder(Path(sys.argv[1]), "one")
folder.add_source("title = 'kept'")
for case in ("a", "b"):
    writer = CaseWriter(folder.case(case), robot, channels.all, {"experiment": "own", "seed": 5, "title": "kept"})
    recorder = CaseRecorder(writer, len(channels))
    for number in range(750):
        recorder.write(np.full(len(channels), 0.002 * number))
    if case == "a":
        recorder.close(RunOutcome.COMPLETE)
print("written", flush=True)
time.sleep(60.0)
"""


@pytest.fixture
def killed(tmp_path, environment):
    """Return a folder of runs whose only run was killed by a signal."""

    def kill(number: int):
        runs = tmp_path / "runs"
        command = [sys.executable, "-c", RECORD, str(runs)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"written\n"
            assert recover(runs) == ([], [])  # the process that writes this run is still alive
            os.kill(process.pid, number)
        return runs

    return kill


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_recovery_finishes_labels_and_renames_a_killed_run(killed, number):
    runs = killed(number)
    assert [path.name for path in runs.iterdir()] == [f"one{PARTIAL_SUFFIX}"]

    assert recover(runs).folders == [runs / "one"]
    assert sorted(path.name for path in (runs / "one").iterdir()) == [
        "a.mcap",
        "b.mcap",
        "experiment.toml",
        "summary.json",
    ]
    whole, cut = read_case(runs / "one" / "a.mcap"), read_case(runs / "one" / "b.mcap")
    assert (whole.label, len(whole.rows)) == (RunOutcome.COMPLETE, 750)
    assert cut.label is RunOutcome.INTERRUPTED
    assert len(cut.rows) >= 500  # the first full block was written to the disk
    assert (cut.rows == whole.rows[: len(cut.rows)]).all()
    summary = json.loads((runs / "one" / "summary.json").read_text(encoding="utf-8"))
    assert (summary["experiment"], summary["seed"], summary["title"]) == ("own", 5, "kept")
    assert (summary["label"], summary["completed"]) == ("interrupted", False)
    assert summary["cases"]["a"]["completed"]
    assert not summary["cases"]["b"]["completed"]
    assert recover(runs) == ([], [])


def test_a_second_recovery_changes_nothing_and_overwrites_no_folder(killed):
    runs = killed(signal.SIGKILL)
    assert recover(runs).folders == [runs / "one"]
    before = (runs / "one" / "b.mcap").read_bytes()
    # The state of a recovery that was killed before it renamed the last file and the folder.
    (runs / "one" / "b.mcap").rename(runs / "one" / f"b.mcap{PARTIAL_SUFFIX}")
    (runs / "one" / MARK_FILE).write_text(MARK_TEXT, encoding="utf-8")
    (runs / "one").rename(runs / f"one{PARTIAL_SUFFIX}")
    (runs / "one").mkdir()

    assert recover(runs).folders == [runs / "one-2"]
    assert (runs / "one-2" / "b.mcap").read_bytes() == before
    assert list((runs / "one").iterdir()) == []
