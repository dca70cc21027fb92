"""Disk full: looked at before a start; no write in the loop; the run ends safely and is labelled *incomplete*."""

import resource
import tempfile
from pathlib import Path

import pytest

from station.control.process import ring_width
from station.control.ring import Ring
from station.recording.label import Label, RecordingError
from station.recording.read import read_case
from station.recording.recover import recover
from station.service.live_recording import LiveRecording
from tests.harness.calm import CLOCK
from tests.harness.kill_stations import until_moving
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until


def test_a_run_that_does_not_fit_is_refused_before_it_begins(paper) -> None:
    ring = Ring(ring_width(paper))
    # a day of telemetry is more than any computer has memory for to make a disk of
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        recording = LiveRecording(ring, paper, Path(folder), CLOCK)
        try:
            with pytest.raises(
                RecordingError, match=r"MB are free, a recording of 86400 s needs 5\d{4} MB; delete old"
            ):
                recording.begin("long", 86400.0, 0.0, {})
        finally:
            recording.close()
            ring.close(remove=True)


def test_a_run_that_fills_the_disk_ends_safely_and_is_kept_as_far_as_it_came(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    (partial,) = recordings.glob(f"{run}*/run.mcap.partial")
    recorder, unlimited = mortal.child("recorder").pid, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    # The disk takes so much more of the recording and nothing beyond.
    most = partial.stat().st_size + 100_000
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now)
    finally:
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, unlimited)
    assert status["state"] == "HOLD"
    assert status["cause"].startswith("the recording has ended: ")
    assert "the disk takes no more of the recording" in status["cause"]
    assert mortal.ask("reset")["state"] == "READY"
    recover(recordings)
    (kept,) = recordings.glob(f"{run}*/run.mcap")
    last = read_case(kept)
    assert last.label is Label.INCOMPLETE
    assert len(last.rows) > 500
