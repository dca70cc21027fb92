"""The folder of a run is complete or has a provisional name."""

import json
import shutil

import pytest

from station.recording.recover import recover
from station.recording.run_folder import (
    FREE_SPACE_BYTES,
    RECORDING_BYTES_PER_S,
    RunFolder,
    free_space_problem,
    lock_folder,
    write_json,
)
from station.recording.run_outcome import RecordingError
from tests.harness.full_disk import full_disk


def test_a_run_folder_is_locked_until_it_is_finished(tmp_path):
    folder = RunFolder(tmp_path, "one")
    folder.case("a").write_bytes(b"")
    assert lock_folder(folder.partial) is None
    assert recover(tmp_path) == ([], [])
    folder.finish({"completed": True})

    assert folder.path == tmp_path / "one"
    assert json.loads((folder.path / "summary.json").read_text(encoding="utf-8")) == {"completed": True}
    assert [path.name for path in tmp_path.iterdir()] == ["one"]


def test_a_run_folder_whose_name_is_in_use_gets_a_number(tmp_path):
    first = RunFolder(tmp_path, "one")
    second = RunFolder(tmp_path, "one")
    for folder in (second, first):
        folder.finish({})
    RunFolder(tmp_path, "one").finish({})

    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "one-2", "one-3"]


def test_a_file_at_the_path_of_the_runs_folder_is_named(tmp_path):
    (tmp_path / "runs").write_text("a file", encoding="utf-8")
    with pytest.raises(RecordingError, match="runs: cannot write results"):
        RunFolder(tmp_path / "runs", "one")


def test_a_run_folder_that_cannot_be_marked_is_removed(tmp_path):
    with full_disk(0), pytest.raises(RecordingError, match="cannot write results: File too large"):
        RunFolder(tmp_path, "one")
    assert list(tmp_path.iterdir()) == []


def test_a_run_folder_that_cannot_be_finished_is_kept(tmp_path):
    folder = RunFolder(tmp_path, "one")
    folder.case("a").write_bytes(b"kept")
    (folder.partial / "summary.json").mkdir()  # prevents the writing of the summary
    with pytest.raises(RecordingError, match="cannot write results"):
        folder.finish({})

    assert (tmp_path / "one.partial" / "a.mcap").read_bytes() == b"kept"


def test_write_json_replaces_a_file_atomically(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": 1})
    write_json(path, {"a": 2})

    assert json.loads(path.read_text(encoding="utf-8")) == {"a": 2}
    assert [one.name for one in tmp_path.iterdir()] == ["a.json"]


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
