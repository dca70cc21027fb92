"""A recording that cannot start before the deadline of its run is refused, and the next run is recorded."""

import signal
from pathlib import Path

import psutil
import pytest

from station.config.robots import load_robot
from station.control.clock import REAL_TIME_CLOCK
from station.control.states import State
from station.recording.read import read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from station.service.runs import LiveRecording
from tests.harness.waiting import until
from tests.tools.kill_recordings import Feed


def test_start_of_a_run_waits_for_the_recorder_only_until_its_deadline(tmp_path: Path) -> None:
    robot = load_robot("paper")
    with Feed(robot) as feed:
        recording = LiveRecording(feed.ring, robot, tmp_path, REAL_TIME_CLOCK)
        recorder = psutil.Process(recording.pid)
        try:
            recorder.send_signal(signal.SIGSTOP)
            with pytest.raises(RecordingError, match="the recorder did not start in time"):
                recording.begin("late", 1.0, 0.0, {}, REAL_TIME_CLOCK.now() + 0.2)
            recorder.send_signal(signal.SIGCONT)
            assert recording.begin("next", 1.0, 0.0, {}) == "next"
            recording.end(State.READY, "")
            until(lambda: not recording.finishing)
        finally:
            recorder.send_signal(signal.SIGCONT)
            recording.close()
    assert read_case(tmp_path / "late" / "run.mcap").label is RunOutcome.STOPPED
    assert read_case(tmp_path / "next" / "run.mcap").label is RunOutcome.COMPLETE
