"""Manifests: complete lines, recognition of the same sweep, and merging of parts."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from station.experiments.manifest import Manifest, folder_of, merged, read
from station.experiments.sweep_plan import SweepPlan
from station.recording.metadata import PACKAGES, versions
from station.recording.run_outcome import RecordingError
from tests.harness.full_disk import full_disk

FOUND = versions()
VERSIONS = {name: FOUND[name] for name in PACKAGES}


def a_plan(**changes: Any) -> SweepPlan:
    """Return a plan with two settings of one case and three seeds."""
    fields = {
        "experiment": "own", "title": "own", "source": "a = 1\n", "labs": ("a lab",), "cases": ("hold",), "seeds": 3,
        "settings": ({"controller.k1": 1}, {"controller.k1": [5, 0.1]}), "contents": "x", "versions": VERSIONS,
        "started": 1.0,
    }  # fmt: skip
    return SweepPlan(**{**fields, **changes})


def a_row(plan: SweepPlan, run: int) -> Mapping[str, Any]:
    setting, case, seed = plan.about()[run]
    row = {"run": run, "setting": dict(setting), "case": case, "seed": seed, "versions": FOUND}
    return {**row, "completed": True, "cause": "", "rms_error_mm": [0.1 * run, 1 / 3, float("inf")]}


def filled(folder: Path, plan: SweepPlan, *runs: int, part: int = 1) -> Path:
    """Return the path of a manifest with these runs."""
    with Manifest(folder, plan, part) as manifest:
        for run in runs:
            manifest.append(a_row(plan, run))
        return manifest.path


def test_rows_of_a_sweep_manifest_are_read_back_bit_for_bit(tmp_path):
    plan = a_plan()
    path = filled(tmp_path / "sweep", plan, 4, 0)

    assert path == tmp_path / "sweep" / "manifest.jsonl"
    assert len(path.read_text(encoding="utf-8").splitlines()) == 3
    with Manifest(tmp_path / "sweep", plan.model_copy(update={"started": 99.0})) as again:
        assert again.rows == {run: a_row(plan, run) for run in (4, 0)}
        assert again.plan.started == plan.started
    assert read(path).plan == plan


def test_a_row_is_on_the_disk_after_it_was_appended_to_the_manifest(tmp_path):
    plan = a_plan()
    with Manifest(tmp_path, plan) as manifest:
        for run in range(3):
            manifest.append(a_row(plan, run))
            assert list(read(manifest.path).rows) == list(range(run + 1))


def test_an_incomplete_last_line_of_a_manifest_is_dropped_and_its_run_is_repeated(tmp_path):
    plan = a_plan()
    whole = filled(tmp_path / "whole", plan, 0, 1).read_bytes()
    ends = [number + 1 for number, sign in enumerate(whole) if sign == ord("\n")]
    for length in range(0, len(whole), 7):
        folder = tmp_path / str(length)
        folder.mkdir()
        (folder / "manifest.jsonl").write_bytes(whole[:length])
        left = sum(end <= length for end in ends[1:])
        assert list(read(folder / "manifest.jsonl").rows) == list(range(left))
        assert filled(folder, plan, *range(left, 2)).read_bytes() == whole


def test_garbage_at_the_end_of_a_manifest_after_a_power_loss_is_dropped(tmp_path):
    plan = a_plan()
    path = filled(tmp_path, plan, 0)
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0" * 40 + b"\n")

    assert filled(tmp_path, plan).read_bytes()[: len(whole)] == whole
    assert list(read(path).rows) == [0]
    filled(tmp_path, plan, 1)
    assert list(read(path).rows) == [0, 1]


def test_a_full_disk_raises_an_error_and_leaves_no_incomplete_line_in_the_manifest(tmp_path):
    plan = a_plan()
    with Manifest(tmp_path, plan) as manifest:
        manifest.append(a_row(plan, 0))
        before = manifest.path.read_bytes()
        with (
            full_disk(len(before) + 100),
            pytest.raises(RecordingError, match=r"manifest\.jsonl: cannot be written: File"),
        ):
            manifest.append(a_row(plan, 1))
        assert manifest.path.read_bytes() == before
        assert list(manifest.rows) == [0]
        manifest.append(a_row(plan, 1))
    assert list(read(manifest.path).rows) == [0, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"experiment": "other"}, 'the experiment: "own" stored, "other" requested'),
        ({"seeds": 4}, "--seeds: 3 stored, 4 requested"),
        ({"settings": ({},)}, "--set .*controller.k1.* stored, .*{}.* requested"),
        ({"cases": ("hold", "move")}, "the cases: "),
        ({"source": "a = 2\n"}, "the experiment's file has changed since"),
        ({"contents": "y"}, "a robot, lab, calibration or motion"),
        ({"versions": {**VERSIONS, "numpy": "1.0"}}, "the versions: .* requested"),
        ({"parts": 2}, "the number of parts: 1 stored, 2 requested"),
    ],
)
def test_a_manifest_of_another_sweep_is_refused_with_the_difference(tmp_path, changes, message):
    path = filled(tmp_path, a_plan(), 0)
    before = path.read_bytes()

    with pytest.raises(RecordingError, match=f"the folder has another sweep: {message}"):
        filled(tmp_path, a_plan(**changes), 1)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == before


def test_a_manifest_is_locked_for_one_writing_process_at_a_time(tmp_path):
    plan = a_plan(parts=2)
    with Manifest(tmp_path, plan, 1):
        with pytest.raises(RecordingError, match="another process carries this sweep out"):
            Manifest(tmp_path, plan, 1)
        filled(tmp_path, plan, 1, part=2)
    filled(tmp_path, plan, 0, part=1)


def test_a_sweep_refuses_the_folder_of_another_run(tmp_path):
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RecordingError, match="the folder has another run"):
        Manifest(tmp_path, a_plan())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"run": 7}, "not a run of this part"),
        ({"run": 1}, "not a run of this part"),
        ({"seed": 1}, "another setting, case or seed"),
        ({"case": "move"}, "another setting, case or seed"),
        ({"setting": {"controller.k1": 2}}, "another setting, case or seed"),
        ({"cause": None}, "has no valid outcome"),
        ({"versions": {**FOUND, "scipy": "1.0"}}, f"made with scipy 1.0, but this sweep uses {FOUND['scipy']}"),
    ],
)
def test_a_manifest_neither_stores_nor_reads_a_row_of_another_part(tmp_path, changes, message):
    plan = a_plan(parts=2)
    row = {**a_row(plan, 0), **changes}
    with Manifest(tmp_path, plan, 1) as manifest:
        with pytest.raises(RecordingError, match=message):
            manifest.append(row)
        assert manifest.rows == {}
    with manifest.path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
    with pytest.raises(RecordingError, match=f"line 2: .*{message}"):
        read(manifest.path)


def test_a_manifest_with_a_duplicate_run_or_a_corrupt_line_is_refused_with_its_number(tmp_path):
    plan = a_plan()
    path = filled(tmp_path, plan, 0, 1)
    first, one, two = path.read_bytes().splitlines(keepends=True)

    path.write_bytes(first + one + two + one)
    with pytest.raises(RecordingError, match="line 4: the run occurs twice"):
        read(path)
    path.write_bytes(first + one[:-9] + b"\n" + two)
    with pytest.raises(RecordingError, match="line 2: not JSON"):
        read(path)
    path.write_bytes(b'{"sweep": 1}\n')
    with pytest.raises(RecordingError, match="not a manifest of this version"):
        read(path)


def test_parts_of_a_sweep_divide_all_runs_and_are_merged_in_order(tmp_path):
    plan = a_plan(parts=4)
    parts = [plan.part(number) for number in range(1, 5)]
    assert sorted(run for part in parts for run in part) == list(range(6))
    for number in (3, 1, 4, 2):
        filled(tmp_path, plan, *reversed(plan.part(number)), part=number)

    found, rows = merged(tmp_path)
    assert (found, rows) == (plan, [a_row(plan, run) for run in range(6)])


def test_a_sweep_with_more_parts_than_runs_has_empty_parts(tmp_path):
    plan = a_plan(parts=8)
    for number in range(1, 9):
        filled(tmp_path, plan, *plan.part(number), part=number)
    assert len(merged(tmp_path)[1]) == 6


def test_merging_a_sweep_with_missing_unfinished_or_foreign_parts_is_refused_with_the_reason(tmp_path):
    plan = a_plan(parts=2)
    with pytest.raises(RecordingError, match="the folder has no sweep"):
        merged(tmp_path)
    filled(tmp_path, plan, *plan.part(2), part=2)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl is missing: .* --part 1/2"):
        merged(tmp_path)
    filled(tmp_path, plan, 0, part=1)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl: 2 of 3 runs are missing; .*--part 1/2, cont"):
        merged(tmp_path)
    other = filled(tmp_path / "other", a_plan(parts=2, seeds=4), *range(0, 8, 2))
    other.replace(tmp_path / other.name)
    with pytest.raises(RecordingError, match="the folder has another sweep: --seeds"):
        merged(tmp_path)


def test_a_manifest_with_the_file_name_of_another_part_is_refused(tmp_path):
    plan = a_plan(parts=2)
    filled(tmp_path, plan, *plan.part(1), part=1)
    (tmp_path / "manifest-2-of-2.jsonl").write_bytes((tmp_path / "manifest-1-of-2.jsonl").read_bytes())
    with pytest.raises(RecordingError, match=r"manifest-2-of-2\.jsonl, line 2: not a run of this part"):
        merged(tmp_path)


def test_the_same_sweep_command_without_a_folder_continues_until_the_sweep_is_done(tmp_path):
    plan = a_plan()
    first = folder_of(tmp_path, plan)
    filled(first, plan, 0)

    assert folder_of(tmp_path, plan) == first
    assert folder_of(tmp_path, a_plan(seeds=4)) != first
    filled(first, plan, *range(1, 6))
    assert folder_of(tmp_path, plan) != first
