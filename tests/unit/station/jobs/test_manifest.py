"""Manifests: complete lines, and recognition of the same list of jobs."""

from pathlib import Path
from typing import Any

import pytest

from station.jobs.manifest import Manifest, read, read_plan
from station.recording.run_outcome import RecordingError
from tests.harness.full_disk import full_disk

PLAN = {
    "study": {"seed": 3, "title": "own"},
    "settings": ({"k1": 1}, {"k1": [5, 0.1]}),
    "digest": 70 * "x",
    "started": 1,
}


def number(row: Any) -> int:
    if not isinstance(row["number"], int):
        raise ValueError("the number is not whole")
    return row["number"]


def a_row(number: int) -> dict[str, Any]:
    return {"number": number, "error_mm": [0.1 * number, 1 / 3, float("inf")]}


def filled(path: Path, *numbers: int, **changes: Any) -> bytes:
    """Return the content of a manifest to which these jobs were added."""
    with Manifest(path, {**PLAN, **changes}, number) as manifest:
        for each in numbers:
            manifest[each] = a_row(each)
            assert each in read(path, number)[1]  # on the disk at once
    return path.read_bytes()


def test_rows_of_a_manifest_are_read_back_bit_for_bit_with_the_time_of_the_first_start(tmp_path):
    path = tmp_path / "new" / "jobs.jsonl"
    assert filled(path, 4, 0).count(b"\n") == 3
    with Manifest(path, {**PLAN, "started": 99}, number) as again:
        assert again.rows == {4: a_row(4), 0: a_row(0)}
        assert again.plan["started"] == 1
        assert (4 in again, 1 in again) == (True, False)


def test_an_incomplete_last_line_of_a_manifest_is_dropped_and_its_job_is_repeated(tmp_path):
    whole = filled(tmp_path / "whole.jsonl", 0, 1)
    ends = [at + 1 for at, sign in enumerate(whole) if sign == ord("\n")]
    for length in range(0, len(whole), 41):
        path = tmp_path / f"{length}.jsonl"
        path.write_bytes(whole[:length])
        left = sum(end <= length for end in ends[1:])
        assert list(read(path, number)[1]) == list(range(left))
        assert filled(path, *range(left, 2)) == whole


def test_garbage_at_the_end_of_a_manifest_after_a_power_loss_is_dropped(tmp_path):
    path = tmp_path / "jobs.jsonl"
    path.write_bytes(filled(path, 0) + b"\0" * 40 + b"\n")
    filled(path, 1)
    assert list(read(path, number)[1]) == [0, 1]


def test_a_full_disk_raises_an_error_and_leaves_no_incomplete_line_in_the_manifest(tmp_path):
    path = tmp_path / "jobs.jsonl"
    with Manifest(path, PLAN, number) as manifest:
        manifest[0] = a_row(0)
        before = path.read_bytes()
        with full_disk(len(before) + 20), pytest.raises(RecordingError, match=r"jobs\.jsonl: cannot be written: File"):
            manifest[1] = a_row(1)
        assert (path.read_bytes(), list(manifest.rows)) == (before, [0])
        manifest[1] = a_row(1)
    assert list(read(path, number)[1]) == [0, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"study": {"seed": 4, "title": "own"}}, "study.seed: 3 stored, 4 requested"),
        ({"settings": ({},)}, r'settings: .*"k1": 1.* stored, \[{}\] requested'),
        ({"digest": 70 * "y"}, "digest has changed since"),
        ({"new": 1}, "new: null stored, 1 requested"),
    ],
)
def test_a_manifest_with_another_plan_is_refused_with_the_first_difference(tmp_path, changes, message):
    path = tmp_path / "jobs.jsonl"
    before = filled(path, 0)
    with pytest.raises(RecordingError, match=f"the folder has other results: {message}; choose another folder"):
        filled(path, 1, **changes)
    assert path.read_bytes() == before


def test_a_manifest_is_locked_for_one_writing_process_at_a_time(tmp_path):
    path = tmp_path / "jobs.jsonl"
    with Manifest(path, PLAN, number), pytest.raises(RecordingError, match="another process carries out these jobs"):
        filled(path)
    filled(path, 0)


def test_a_manifest_neither_stores_nor_reads_an_invalid_line_and_names_its_number(tmp_path):
    path = tmp_path / "jobs.jsonl"
    first, one, two = filled(path, 0, 1).splitlines(keepends=True)
    with (
        Manifest(path, PLAN, number) as manifest,
        pytest.raises(RecordingError, match="not stored: the number is not whole"),
    ):
        manifest[2] = {"number": "2"}
    for lines, message in (
        (first + one + two + one, "line 4: the job occurs twice"),
        (first + b'{"number": "2"}\n', "line 2: the number is not whole"),
        (first + one[:-9] + b"\n" + two, "line 2: not a JSON object"),
        (b"notes\n", "line 1: not a JSON object"),
    ):
        path.write_bytes(lines)
        with pytest.raises(RecordingError, match=message):
            Manifest(path, PLAN, number)
        assert path.read_bytes() == lines
    with pytest.raises(RecordingError, match="cannot be read"):
        read_plan(tmp_path / "missing.jsonl")
