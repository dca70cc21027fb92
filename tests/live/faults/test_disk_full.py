"""Behaviour on a full disk: the free space is checked before a start, and a run that fills the disk ends in HOLD.

Such a run is labelled *incomplete*, and its written part is kept. The control loop never writes to the disk.
"""

import resource
import tempfile
from pathlib import Path

import pytest

from station.control.process import ring_width
from station.control.ring import Ring
from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_outcome import RecordingError, RunOutcome
from station.service.runs import LiveRecording
from tests.harness.calm import CLOCK
from tests.harness.lone_station import LoneStation
from tests.harness.waiting import until
from tests.tools.kill_stations import until_moving


def test_recording_larger_than_the_free_space_is_refused_before_the_run(paper) -> None:
    ring = Ring(ring_width(paper))
    # Ten days of telemetry need 347 GB, which is more than a file system in memory has.
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        recording = LiveRecording(ring, paper, Path(folder), CLOCK)
        try:
            with pytest.raises(
                RecordingError, match=r"MB are free, a recording of 864000 s needs 3\d{5} MB; delete old"
            ):
                recording.begin("long", 864000.0, 0.0, {})
        finally:
            recording.close()
            ring.close(remove=True)


def test_run_that_fills_the_disk_ends_in_hold_and_its_written_part_is_kept(
    mortal: LoneStation, recordings: Path
) -> None:
    until_moving(mortal)
    run = mortal.ask("status")["run"]
    (partial,) = recordings.glob(f"{run}*/run.mcap.partial")
    recorder, unlimited = mortal.child("recorder").pid, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    # This limit simulates a disk on which 100 kB are free.
    most = partial.stat().st_size + 100_000
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        status = until(lambda: (now := mortal.ask("status"))["state"] != "RUNNING" and now["cause"] and now)
    finally:
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, unlimited)
    assert status["state"] == "HOLD"
    assert status["cause"].startswith("the recording has ended: ")
    assert "the recording cannot be continued" in status["cause"]
    assert mortal.ask("reset")["state"] == "READY"
    recover(recordings)
    (kept,) = recordings.glob(f"{run}*/run.mcap")
    last = read_case(kept)
    assert last.label is RunOutcome.INCOMPLETE
    assert len(last.rows) > 500
