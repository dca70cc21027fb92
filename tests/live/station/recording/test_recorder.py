"""The live recorder in a process of its own, on a real ring that is really written at 500 Hz."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from station.config.robots import RobotFile, load_robot
from station.control.ring import ROWS, Ring
from station.control.task import Phase
from station.recording.events import Event
from station.recording.label import Label, RecordingError
from station.recording.read import CaseRecording, read_case
from station.recording.recorder import Recorder
from station.recording.recover import recover
from tests.harness.kill_recordings import PERIOD, Feed, kill_recorder
from tests.harness.waiting import until


@pytest.fixture(scope="module")
def feed() -> Iterator[Feed]:
    with Feed(load_robot("paper")) as feed:
        yield feed


@pytest.fixture
def recorder(feed: Feed, paper: RobotFile, tmp_path: Path) -> Iterator[Recorder]:
    recorder = Recorder(feed.ring, paper, tmp_path / "runs")
    yield recorder
    recorder.close()


def is_what_was_fed(read: CaseRecording, feed: Feed) -> bool:
    first = round(read.rows[0, 0] / PERIOD)
    return bool((read.rows == np.array([feed.row(first + number) for number in range(len(read.rows))])).all())


def test_a_run_is_recorded_from_its_beginning_to_its_end(recorder, feed, paper, tmp_path):
    first = feed.ring.written
    path = recorder.begin("one", {"title": "a circle", "experiment": "own", "seed": 3})
    begun = feed.ring.written
    recorder.event(Event(float(feed.ring.written) * PERIOD, "state", "RUNNING"))
    until(lambda: feed.ring.written > first + 400)
    last = feed.ring.written
    assert recorder.end(Label.COMPLETE, numbers={"mean_error_mm": 0.1}) == path == tmp_path / "runs" / "one"

    read = read_case(path / "run.mcap")
    assert first <= round(read.rows[0, 0] / PERIOD) <= begun
    assert round(read.rows[-1, 0] / PERIOD) >= last - 1
    assert is_what_was_fed(read, feed)
    assert [event.text for event in read.events] == ["RUNNING"]
    assert read.label is Label.COMPLETE
    assert RobotFile.model_validate(read.metadata["robot"], strict=False) == paper
    assert recorder.trouble() == ""


def test_one_recorder_records_run_after_run(recorder, feed, tmp_path):
    for name in ("one", "two"):
        recorder.begin(name, {})
        with pytest.raises(RecordingError, match="a recording is on already"):
            recorder.begin("three", {})
        recorder.end(Label.STOPPED, "stopped by the operator")
        with pytest.raises(RecordingError, match="nothing is being recorded"):
            recorder.end(Label.COMPLETE)

    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["one", "two"]


@pytest.mark.parametrize("after", [0.45, 1.1])
def test_kill_9_loses_no_row_that_is_older_than_300_ms(feed, paper, tmp_path, after):
    assert kill_recorder(tmp_path, feed, paper, after).rows > 0


def test_asked_to_end_it_finishes_the_recording_as_interrupted(recorder, tmp_path):
    path = recorder.begin("one", {})
    os.kill(recorder.child.pid, signal.SIGTERM)
    recorder.child.ended()

    assert read_case(path / "run.mcap").label is Label.INTERRUPTED
    assert "the recorder ended with status 0" in recorder.trouble()
    with pytest.raises(RecordingError, match="the recorder ended"):
        recorder.begin("two", {})


#: A parent that starts recording and is then killed from outside.
PARENT = """
import sys, time
from pathlib import Path
from station.recording.recorder import Recorder
from station.config.robots import load_robot
from tests.harness.kill_recordings import Feed

if __name__ == "__main__":
    robot = load_robot("paper")
    with Feed(robot) as feed:
        recorder = Recorder(feed.ring, robot, Path(sys.argv[1]))
        recorder.begin("one", {})
        time.sleep(0.5)
        print(recorder.child.pid, feed.ring.written, flush=True)
        time.sleep(60.0)
"""


def test_when_the_parent_is_killed_the_recording_is_finished_as_interrupted(tmp_path, environment):
    script = tmp_path / "parent.py"
    script.write_text(PARENT, encoding="utf-8")
    runs = tmp_path / "runs"
    command = [sys.executable, str(script), str(runs)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as parent:
        assert parent.stdout is not None
        pid, written = map(int, parent.stdout.readline().split())
        recorder = psutil.Process(pid)
        parent.kill()
    until(lambda: not recorder.is_running() or recorder.status() == psutil.STATUS_ZOMBIE)

    read = read_case(runs / "one" / "run.mcap")
    assert (read.label, read.cause) == (Label.INTERRUPTED, "the station process is gone")
    assert read.rows[-1, 0] >= (written - 1) * PERIOD
    assert recover(runs) == []


def test_a_full_disk_ends_the_recording_and_is_told_unasked(recorder, feed, tmp_path):
    path = recorder.begin("one", {})
    partial = tmp_path / "runs" / "one.partial" / "run.mcap.partial"
    limit = until(lambda: (size := partial.stat().st_size) > 100_000 and size) + 100_000
    resource.prlimit(recorder.child.pid, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    said = until(recorder.trouble)

    assert "the disk takes no more of the recording: File too large" in said
    with pytest.raises(RecordingError, match="nothing is being recorded"):
        recorder.end(Label.COMPLETE)
    recover(tmp_path / "runs")  # finishes what there was no room for
    read = read_case(path / "run.mcap")
    assert read.label is Label.INCOMPLETE
    assert is_what_was_fed(read, feed)


def test_rows_that_were_overwritten_before_they_were_read_are_counted(paper, channels, make_rows, tmp_path):
    ring = Ring(len(channels))
    recorder = Recorder(ring, paper, tmp_path)
    try:
        path = recorder.begin("one", {})
        process = psutil.Process(recorder.child.pid)
        process.suspend()
        rows = make_rows(ROWS + 500)
        for row in rows:
            ring.write(row)
        process.resume()
        recorder.end(Label.COMPLETE)
    finally:
        recorder.close()
        ring.close(remove=True)

    read = read_case(path / "run.mcap")
    (event,) = read.events
    assert event.data["missed"] == len(rows) - len(read.rows) >= 500
    assert (read.rows == rows[-len(read.rows) :]).all()


def test_rows_and_errors_end_with_the_motion_whenever_the_recorder_is_told(paper, channels, make_rows, tmp_path):
    rows, moving = make_rows(1500), slice(200, 1200)
    channels.of(rows, "phase")[:] = Phase.NONE
    channels.of(rows[moving], "phase")[:] = Phase.MOVING
    channels.of(rows, "tip_desired")[:] = channels.of(rows, "tip_true")[:] = channels.of(rows, "tip_measured")[:] = 0.0
    channels.of(rows, "tip_time")[:] = channels.of(rows, "time")
    channels.of(rows, "target_followed")[:] = 0.0
    channels.of(rows, "tip_true")[moving.stop :] = channels.of(rows, "tip_measured")[moving.stop :] = 0.006
    ring = Ring(len(channels))
    recorder = Recorder(ring, paper, tmp_path)
    try:
        path = recorder.begin("one", {}, counted_from=1.0)
        for row in rows:
            ring.write(row)
        recorder.end(Label.COMPLETE)
    finally:
        recorder.close()
        ring.close(remove=True)

    read = read_case(path / "run.mcap")
    numbers = json.loads((path / "summary.json").read_text(encoding="utf-8"))["cases"]["run"]
    assert np.array_equal(read.rows, rows[: moving.stop])
    assert (numbers["motion_start"], numbers["counted_from_s"]) == (rows[moving.start, 0], 1.0)
    assert numbers["true_max_abs_error_mm"] == numbers["max_abs_error_mm"] == [0.0, 0.0, 0.0]


def test_a_folder_that_cannot_be_written_is_refused_at_the_beginning(feed, paper, tmp_path):
    (tmp_path / "runs").write_text("a file", encoding="utf-8")
    recorder = Recorder(feed.ring, paper, tmp_path / "runs")
    try:
        with pytest.raises(RecordingError, match="runs: cannot write results there"):
            recorder.begin("one", {})
    finally:
        recorder.close()
