"""Check of the free disk space before a start."""

import shutil

from station.recording.space import FREE_SPACE_BYTES, RECORDING_BYTES_PER_S, free_space_problem


def test_the_disk_space_check_accepts_a_short_recording_and_refuses_one_that_does_not_fit(tmp_path):
    free = shutil.disk_usage(tmp_path).free
    longest = (free - FREE_SPACE_BYTES) / RECORDING_BYTES_PER_S

    assert free_space_problem(tmp_path / "runs" / "deep", 0.5 * longest) == ""
    problem = free_space_problem(tmp_path / "runs" / "deep", 2.0 * longest)
    assert "runs/deep" in problem
    assert "MB are free" in problem
    assert "delete old runs or shorten this one" in problem


def test_the_data_rate_assumed_by_the_disk_space_check_exceeds_that_of_a_recording(recorded, make_rows):
    # Random numbers are incompressible, so they need more space than any run.
    size = recorded(make_rows(1000)).stat().st_size
    assert size / 2.0 < RECORDING_BYTES_PER_S
