"""The folder of a sweep: recognition of the same sweep, and merging of parts."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from station.experiments.sweep_folder import folder_of, merged, run_number, sweep_manifest
from station.experiments.sweep_plan import SweepPlan
from station.jobs.manifest import read
from station.recording.metadata import PACKAGES, versions
from station.recording.run_outcome import RecordingError

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
    with sweep_manifest(folder, plan, part) as manifest:
        for run in runs:
            manifest[run] = a_row(plan, run)
        return manifest.path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": 4}, "seeds: 3 stored, 4 requested"),
        ({"versions": {**VERSIONS, "numpy": "1.0"}}, 'versions.numpy: .* stored, "1.0" requested'),
        ({"parts": 2}, "parts: 1 stored, 2 requested"),
    ],
)
def test_the_folder_of_another_sweep_is_refused_with_the_difference(tmp_path, changes, message):
    path = filled(tmp_path, a_plan(), 0)
    with pytest.raises(RecordingError, match=f"the folder has other results: {message}"):
        filled(tmp_path, a_plan(**changes), 1)
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_the_parts_of_a_sweep_are_locked_separately(tmp_path):
    plan = a_plan(parts=2)
    with sweep_manifest(tmp_path, plan, 1):
        with pytest.raises(RecordingError, match="another process carries out these jobs"):
            sweep_manifest(tmp_path, plan, 1)
        filled(tmp_path, plan, 1, part=2)


@pytest.mark.parametrize("name", ["summary.json", "experiment.toml", "sweep.json", "report.html"])
def test_a_sweep_refuses_a_folder_in_which_it_would_overwrite_a_file(tmp_path, name):
    (tmp_path / name).write_text("{}", encoding="utf-8")
    with pytest.raises(RecordingError, match=f"the folder has another {name}; choose another folder"):
        sweep_manifest(tmp_path, a_plan())
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"run": 7}, "not a run of this part"),
        ({"run": 1}, "not a run of this part"),
        ({"seed": 1}, "differs in setting, case or seed"),
        ({"case": "move"}, "differs in setting, case or seed"),
        ({"setting": {"controller.k1": 2}}, "differs in setting, case or seed"),
        ({"cause": None}, "has no valid outcome"),
        ({"versions": {**FOUND, "scipy": "1.0"}}, f"made with scipy 1.0, but this sweep uses {FOUND['scipy']}"),
    ],
)
def test_the_manifest_of_a_sweep_neither_stores_nor_reads_a_row_of_another_part(tmp_path, changes, message):
    plan = a_plan(parts=2)
    row = {**a_row(plan, 0), **changes}
    with sweep_manifest(tmp_path, plan, 1) as manifest:
        with pytest.raises(RecordingError, match=message):
            manifest[0] = row
        assert manifest.rows == {}
    with manifest.path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")
    with pytest.raises(RecordingError, match=f"line 2: .*{message}"):
        read(manifest.path, run_number(plan, 1))


def test_parts_of_a_sweep_divide_all_runs_and_are_merged_in_order(tmp_path):
    plan = a_plan(parts=4)
    parts = [plan.part(number) for number in range(1, 5)]
    assert sorted(run for part in parts for run in part) == list(range(6))
    for number in (3, 1, 4, 2):
        filled(tmp_path, plan, *reversed(plan.part(number)), part=number)

    assert merged(tmp_path) == (plan, [a_row(plan, run) for run in range(6)])


def test_a_sweep_with_more_parts_than_runs_has_empty_parts(tmp_path):
    plan = a_plan(parts=8)
    for number in range(1, 9):
        filled(tmp_path, plan, *plan.part(number), part=number)
    assert len(merged(tmp_path)[1]) == 6


def test_merging_a_sweep_with_missing_unfinished_or_foreign_parts_is_refused_with_the_reason(tmp_path):
    plan = a_plan(parts=2)
    with pytest.raises(RecordingError, match="the folder has no sweep"):
        merged(tmp_path)
    second = filled(tmp_path, plan, *plan.part(2), part=2)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl is missing: .* --part 1/2"):
        merged(tmp_path)
    first = filled(tmp_path, plan, 0, part=1)
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl: 2 of 3 runs are missing; .*--part 1/2"):
        merged(tmp_path)
    first.write_bytes(second.read_bytes())
    with pytest.raises(RecordingError, match=r"manifest-1-of-2\.jsonl, line 2: not a run of this part"):
        merged(tmp_path)
    other = filled(tmp_path / "other", a_plan(parts=2, seeds=4), *range(0, 8, 2))
    other.replace(first)
    with pytest.raises(RecordingError, match="the folder has other results: seeds"):
        merged(tmp_path)
    first.write_text('{"sweep": 1}\n', encoding="utf-8")
    with pytest.raises(RecordingError, match="not a manifest of this version"):
        merged(tmp_path)


@pytest.mark.parametrize("kind", ["file", "empty folder", "FIFO", "text", "brackets"])
def test_a_sweep_without_a_folder_uses_no_folder_of_the_user(tmp_path, kind):
    taken = tmp_path / "sweep-own-mine"
    taken.touch() if kind == "file" else taken.mkdir()
    if kind == "FIFO":
        os.mkfifo(taken / "manifest.jsonl")
    elif kind in ("text", "brackets"):
        (taken / "manifest.jsonl").write_text({"text": "mine\n", "brackets": "[" * 100_000 + "\n"}[kind])
    assert not folder_of(tmp_path, a_plan()).exists()


def test_the_same_sweep_command_without_a_folder_continues_until_the_sweep_is_done(tmp_path):
    plan = a_plan()
    first = folder_of(tmp_path, plan)
    filled(first, plan, 0)

    assert folder_of(tmp_path, plan) == first
    assert folder_of(tmp_path, a_plan(seeds=4)) != first
    filled(first, plan, *range(1, 6))
    assert folder_of(tmp_path, plan) != first
