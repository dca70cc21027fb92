"""Whether the disk has room, before a start."""

import shutil

from station.recording.space import RATE, RESERVE, free_space_problem


def test_a_short_recording_fits_and_one_longer_than_the_disk_does_not(tmp_path):
    free = shutil.disk_usage(tmp_path).free
    longest = (free - RESERVE) / RATE

    assert free_space_problem(tmp_path / "runs" / "deep", 0.5 * longest) == ""
    said = free_space_problem(tmp_path / "runs" / "deep", 2.0 * longest)
    assert "runs/deep" in said
    assert "MB are free" in said
    assert "delete old runs or shorten this one" in said


def test_the_rate_is_more_than_a_recording_takes(recorded, make_rows):
    # Random numbers do not compress: worse than any run.
    size = recorded(make_rows(1000)).stat().st_size
    assert size / 2.0 < RATE
