"""The live recorder in a separate process, with a real telemetry ring that is written at 500 Hz."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from station.config.robots import RobotFile, load_robot
from station.control.ring import RING_ROWS, Ring
from station.control.task import Phase
from station.recording.foxglove import RecordedEvent
from station.recording.read import CaseRecording, read_case
from station.recording.recorder import Recorder
from station.recording.recover import recover
from station.recording.run_outcome import RecordingError, RunOutcome
from tests.harness.children import has_ended
from tests.harness.recordings import as_recorded
from tests.harness.waiting import until
from tests.tools.kill_recordings import PERIOD, Feed, kill_recorder


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
    fed = np.array([feed.row(first + number) for number in range(len(read.rows))])
    return bool((read.rows == as_recorded(fed, read.channels)).all())


def test_the_recorder_records_a_run_from_start_to_end(recorder, feed, paper, tmp_path):
    first = feed.ring.written
    path = recorder.begin("one", {"title": "a circle", "experiment": "own", "seed": 3})
    begun = feed.ring.written
    recorder.event(RecordedEvent(float(feed.ring.written) * PERIOD, "state", "RUNNING"))
    until(lambda: feed.ring.written > begun + 400)
    last = feed.ring.written
    assert recorder.end(RunOutcome.COMPLETE, numbers={"mean_error_mm": 0.1}) == path == tmp_path / "runs" / "one"

    read = read_case(path / "run.mcap")
    assert first <= round(read.rows[0, 0] / PERIOD) <= begun
    assert round(read.rows[-1, 0] / PERIOD) >= last - 1
    assert is_what_was_fed(read, feed)
    assert [event.text for event in read.events] == ["RUNNING"]
    assert read.label is RunOutcome.COMPLETE
    assert RobotFile.model_validate(read.metadata["robot"], strict=False) == paper
    assert recorder.trouble() == ""


def test_recorder_records_several_runs_one_after_another(recorder, feed, tmp_path):
    for name in ("one", "two"):
        recorder.begin(name, {})
        with pytest.raises(RecordingError, match="another recording is active"):
            recorder.begin("three", {})
        recorder.end(RunOutcome.STOPPED, "stopped by the operator")
        with pytest.raises(RecordingError, match="no recording is active"):
            recorder.end(RunOutcome.COMPLETE)

    assert sorted(path.name for path in (tmp_path / "runs").iterdir()) == ["one", "two"]


@pytest.mark.parametrize("after", [0.45, 1.1])
def test_killing_the_recorder_loses_no_row_that_is_older_than_300_ms(feed, paper, tmp_path, after):
    assert kill_recorder(tmp_path, feed, paper, after).rows > 0


def test_the_recorder_finishes_its_recording_as_interrupted_on_sigterm(recorder, tmp_path):
    path = recorder.begin("one", {})
    os.kill(recorder.child.pid, signal.SIGTERM)
    recorder.child.ended()

    assert read_case(path / "run.mcap").label is RunOutcome.INTERRUPTED
    assert "the recorder ended with status 0" in recorder.trouble()
    with pytest.raises(RecordingError, match="the recorder ended"):
        recorder.begin("two", {})


#: Program of a parent process that starts a recording and is then killed by the test.
PARENT = """
import sys, time
from pathlib import Path
from station.recording.recorder import Recorder
from station.config.robots import load_robot
from tests.tools.kill_recordings import Feed

if __name__ == "__main__":
    robot = load_robot("paper")
    with Feed(robot) as feed:
        recorder = Recorder(feed.ring, robot, Path(sys.argv[1]))
        recorder.begin("one", {})
        time.sleep(0.5)
        print(recorder.child.pid, feed.ring.written, flush=True)
        time.sleep(60.0)
"""


def test_the_recorder_of_a_killed_parent_finishes_its_recording_as_interrupted(tmp_path, environment):
    script = tmp_path / "parent.py"
    script.write_text(PARENT, encoding="utf-8")
    runs = tmp_path / "runs"
    command = [sys.executable, str(script), str(runs)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as parent:
        assert parent.stdout is not None
        pid, written = map(int, parent.stdout.readline().split())
        recorder = psutil.Process(pid)
        parent.kill()
    until(lambda: has_ended(recorder))

    read = read_case(runs / "one" / "run.mcap")
    assert (read.label, read.cause) == (RunOutcome.INTERRUPTED, "the station process is gone")
    assert read.rows[-1, 0] >= (written - 1) * PERIOD
    assert recover(runs) == ([], [])


def test_the_recorder_counts_rows_that_were_overwritten_in_the_ring(paper, channels, make_rows, tmp_path):
    ring = Ring(len(channels))
    recorder = Recorder(ring, paper, tmp_path)
    try:
        path = recorder.begin("one", {})
        process = psutil.Process(recorder.child.pid)
        process.suspend()
        rows = make_rows(RING_ROWS + 500)
        for row in rows:
            ring.write(row)
        process.resume()
        recorder.end(RunOutcome.COMPLETE)
    finally:
        recorder.close()
        ring.close(remove=True)

    read = read_case(path / "run.mcap")
    (event,) = read.events
    assert event.data["missed"] == len(rows) - len(read.rows) >= 500
    assert (read.rows == as_recorded(rows[-len(read.rows) :], channels.all)).all()


def test_a_live_recording_ends_with_the_motion_even_if_the_request_is_late(paper, channels, make_rows, tmp_path):
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
        recorder.end(RunOutcome.COMPLETE)
    finally:
        recorder.close()
        ring.close(remove=True)

    read = read_case(path / "run.mcap")
    numbers = json.loads((path / "summary.json").read_text(encoding="utf-8"))["cases"]["run"]
    assert np.array_equal(read.rows, as_recorded(rows[: moving.stop], channels.all))
    assert (numbers["motion_start"], numbers["counted_from_s"]) == (rows[moving.start, 0], 1.0)
    assert numbers["true_max_abs_error_mm"] == numbers["max_abs_error_mm"] == [0.0, 0.0, 0.0]


def test_a_recorder_start_with_an_unwritable_folder_is_refused(feed, paper, tmp_path):
    (tmp_path / "runs").write_text("a file", encoding="utf-8")
    recorder = Recorder(feed.ring, paper, tmp_path / "runs")
    try:
        with pytest.raises(RecordingError, match="runs: cannot write results"):
            recorder.begin("one", {})
    finally:
        recorder.close()
