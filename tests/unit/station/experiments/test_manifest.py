"""Manifests: lines that are whole, sweeps that are the same, parts that are put together."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from station.experiments.manifest import Manifest, folder_of, merged, read
from station.experiments.sweep_plan import Plan
from station.recording.label import RecordingError
from station.recording.metadata import PACKAGES, versions
from tests.harness.full_disk import full_disk

FOUND = versions()
VERSIONS = {name: FOUND[name] for name in PACKAGES}


def a_plan(**changes: Any) -> Plan:
    """Two settings of one case, three seeds."""
    told = {
        "experiment": "own", "title": "own", "source": "a = 1\n", "labs": ("a lab",), "cases": ("hold",), "seeds": 3,
        "settings": ({"controller.k1": 1}, {"controller.k1": [5, 0.1]}), "contents": "x", "versions": VERSIONS,
        "started": 1.0,
    }  # fmt: skip
    return Plan(**{**told, **changes})


def a_row(plan: Plan, run: int) -> Mapping[str, Any]:
    setting, case, seed = plan.about()[run]
    row = {"run": run, "setting": dict(setting), "case": case, "seed": seed, "versions": FOUND}
    return {**row, "completed": True, "cause": "", "rms_error_mm": [0.1 * run, 1 / 3, float("inf")]}


def filled(folder: Path, plan: Plan, *runs: int, part: int = 1) -> Path:
    """A manifest with these runs."""
    with Manifest(folder, plan, part) as manifest:
        for run in runs:
            manifest.append(a_row(plan, run))
        return manifest.path


def test_rows_come_back_to_the_last_bit(tmp_path):
    plan = a_plan()
    path = filled(tmp_path / "sweep", plan, 4, 0)

    assert path == tmp_path / "sweep" / "manifest.jsonl"
    assert len(path.read_text(encoding="utf-8").splitlines()) == 3
    with Manifest(tmp_path / "sweep", plan.model_copy(update={"started": 99.0})) as again:
        assert again.rows == {run: a_row(plan, run) for run in (4, 0)}
        assert again.plan.started == plan.started
    assert read(path).plan == plan


def test_a_row_is_on_the_disk_when_it_is_kept(tmp_path):
    plan = a_plan()
    with Manifest(tmp_path, plan) as manifest:
        for run in range(3):
            manifest.append(a_row(plan, run))
            assert list(read(manifest.path).rows) == list(range(run + 1))


def test_half_a_line_at_the_end_is_dropped_and_made_again_wherever_it_was_cut(tmp_path):
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


def test_what_a_lost_power_left_at_the_end_is_dropped_too(tmp_path):
    plan = a_plan()
    path = filled(tmp_path, plan, 0)
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0" * 40 + b"\n")

    assert filled(tmp_path, plan).read_bytes()[: len(whole)] == whole
    assert list(read(path).rows) == [0]
    filled(tmp_path, plan, 1)
    assert list(read(path).rows) == [0, 1]


def test_a_full_disk_leaves_no_half_line_and_says_so(tmp_path):
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
    ("changes", "said"),
    [
        ({"experiment": "other"}, 'the experiment: "own" there, "other" here'),
        ({"seeds": 4}, "--seeds: 3 there, 4 here"),
        ({"settings": ({},)}, "--set .*controller.k1.* there, .*{}.* here"),
        ({"cases": ("hold", "move")}, "the cases: "),
        ({"source": "a = 2\n"}, "the experiment's file has changed since"),
        ({"contents": "y"}, "a robot, lab, calibration or motion"),
        ({"versions": {**VERSIONS, "numpy": "1.0"}}, "the versions: .* here"),
        ({"parts": 2}, "the number of parts: 1 there, 2 here"),
    ],
)
def test_another_sweep_is_refused_with_the_difference(tmp_path, changes, said):
    path = filled(tmp_path, a_plan(), 0)
    before = path.read_bytes()

    with pytest.raises(RecordingError, match=f"another sweep is kept there: {said}"):
        filled(tmp_path, a_plan(**changes), 1)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == before


def test_nobody_else_writes_meanwhile(tmp_path):
    plan = a_plan(parts=2)
    with Manifest(tmp_path, plan, 1):
        with pytest.raises(RecordingError, match="another process carries this sweep out"):
            Manifest(tmp_path, plan, 1)
        filled(tmp_path, plan, 1, part=2)
    filled(tmp_path, plan, 0, part=1)


def test_the_folder_of_a_run_is_not_taken(tmp_path):
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    with pytest.raises(RecordingError, match="there is another run"):
        Manifest(tmp_path, a_plan())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"run": 7}, "no run of this part"),
        ({"run": 1}, "no run of this part"),
        ({"seed": 1}, "another setting, case or seed"),
        ({"case": "move"}, "another setting, case or seed"),
        ({"setting": {"controller.k1": 2}}, "another setting, case or seed"),
        ({"cause": None}, "does not say how it ended"),
        ({"versions": {**FOUND, "scipy": "1.0"}}, f"made with scipy 1.0, this sweep with {FOUND['scipy']}"),
    ],
)
def test_a_row_that_is_none_of_the_part_is_neither_kept_nor_read(tmp_path, changes, said):
    plan = a_plan(parts=2)
    row = {**a_row(plan, 0), **changes}
    with Manifest(tmp_path, plan, 1) as manifest:
        with pytest.raises(RecordingError, match=said):
            manifest.append(row)
        assert manifest.rows == {}
    with manifest.path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
    with pytest.raises(RecordingError, match=f"line 2: .*{said}"):
        read(manifest.path)


def test_a_run_that_is_there_twice_or_a_line_that_is_spoilt_is_named(tmp_path):
    plan = a_plan()
    path = filled(tmp_path, plan, 0, 1)
    first, one, two = path.read_bytes().splitlines(keepends=True)

    path.write_bytes(first + one + two + one)
    with pytest.raises(RecordingError, match="line 4: the run is there twice"):
        read(path)
    path.write_bytes(first + one[:-9] + b"\n" + two)
    with pytest.raises(RecordingError, match="line 2: no JSON"):
        read(path)
    path.write_bytes(b'{"sweep": 1}\n')
    with pytest.raises(RecordingError, match="no manifest of this version"):
        read(path)


def test_parts_share_out_all_runs_and_are_put_together_in_their_order(tmp_path):
    plan = a_plan(parts=4)
    parts = [plan.part(number) for number in range(1, 5)]
    assert sorted(run for part in parts for run in part) == list(range(6))
    for number in (3, 1, 4, 2):
        filled(tmp_path, plan, *reversed(plan.part(number)), part=number)

    found, rows = merged(tmp_path)
    assert (found, rows) == (plan, [a_row(plan, run) for run in range(6)])


def test_more_parts_than_runs_leave_some_empty(tmp_path):
    plan = a_plan(parts=8)
    for number in range(1, 9):
        filled(tmp_path, plan, *plan.part(number), part=number)
    assert len(merged(tmp_path)[1]) == 6


def test_parts_that_are_missing_or_not_done_or_of_another_sweep_are_named(tmp_path):
    plan = a_plan(parts=2)
    with pytest.raises(RecordingError, match="no sweep is kept there"):
        merged(tmp_path)
    filled(tmp_path, plan, *plan.part(2), part=2)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl is missing: .* --part 1/2"):
        merged(tmp_path)
    filled(tmp_path, plan, 0, part=1)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl: 2 of 3 runs are missing; .*--part 1/2, goes on"):
        merged(tmp_path)
    other = filled(tmp_path / "other", a_plan(parts=2, seeds=4), *range(0, 8, 2))
    other.replace(tmp_path / other.name)
    with pytest.raises(RecordingError, match="another sweep is kept there: --seeds"):
        merged(tmp_path)


def test_a_part_under_another_parts_name_is_refused(tmp_path):
    plan = a_plan(parts=2)
    filled(tmp_path, plan, *plan.part(1), part=1)
    (tmp_path / "manifest-2-of-2.jsonl").write_bytes((tmp_path / "manifest-1-of-2.jsonl").read_bytes())
    with pytest.raises(RecordingError, match=r"manifest-2-of-2\.jsonl, line 2: no run of this part"):
        merged(tmp_path)


def test_without_a_folder_the_same_sweep_goes_on_until_it_is_done(tmp_path):
    plan = a_plan()
    first = folder_of(tmp_path, plan)
    filled(first, plan, 0)

    assert folder_of(tmp_path, plan) == first
    assert folder_of(tmp_path, a_plan(seeds=4)) != first
    filled(first, plan, *range(1, 6))
    assert folder_of(tmp_path, plan) != first
