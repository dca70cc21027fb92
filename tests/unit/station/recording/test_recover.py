"""Recovery of unfinished runs: everything of ours is kept, and nothing else is touched."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from station.recording.read import read_case
from station.recording.recover import Recovery, recover
from station.recording.run_folder import FREE_SPACE_BYTES, MARK_FILE, RunFolder, recordings
from station.recording.run_outcome import RunOutcome
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX, CaseWriter
from tests.harness.full_disk import full_disk


@pytest.fixture
def unfinished(tmp_path, open_writer, make_rows, channels) -> Callable[[], bytes]:
    """Return a function that returns the bytes of an unfinished recording of five chunks."""

    def make() -> bytes:
        writer = open_writer("source")
        for number in range(5):
            rows = make_rows(20, 20 * number)
            channels.of(rows, "force_variance")[:] = 0.01
            writer.write(rows)
        content = (tmp_path / f"source.mcap{PARTIAL_SUFFIX}").read_bytes()
        writer.close(RunOutcome.COMPLETE)
        return content

    return make


@pytest.fixture
def open_case_in(paper, channels) -> Callable[[Path], tuple[RunFolder, CaseWriter]]:
    """Return a function that starts a run `one` with a recording in a folder of runs."""

    def start(runs: Path) -> tuple[RunFolder, CaseWriter]:
        folder = RunFolder(runs, "one")
        return folder, CaseWriter(folder.case("run"), paper.robot(), channels.all, {})

    return start


def left_behind(runs: Path, **files: bytes) -> Path:
    """Create the folder that a killed run `one` leaves behind, with files in it; `__` in a name means a point."""
    folder = RunFolder(runs, "one")
    for name, content in files.items():
        (folder.partial / name.replace("__", ".")).write_bytes(content)
    folder.let_go()
    return folder.partial


def summary_of(folder: Path) -> dict[str, str]:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def everything(folder: Path) -> dict[str, bytes | None]:
    """Return the paths in a folder with the contents of files; None for folders."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")
    }  # fmt: skip


def test_a_recording_that_a_full_disk_ended_is_recovered_as_incomplete(tmp_path, unfinished):
    left_behind(tmp_path / "runs", run__mcap__full=unfinished())

    (done,) = recover(tmp_path / "runs").folders
    assert done == tmp_path / "runs" / "one"
    assert sorted(path.name for path in done.iterdir()) == ["run.mcap", "summary.json"]
    read = read_case(done / "run.mcap")
    assert (read.label, len(read.rows)) == (RunOutcome.INCOMPLETE, 100)
    assert (summary_of(done)["label"], summary_of(done)["cause"]) == ("incomplete", "the disk was full")


def test_a_damaged_chunk_of_a_killed_run_is_named_in_its_summary(tmp_path, unfinished):
    content = bytearray(unfinished())
    content[content.index(b"zstd", len(content) // 2) + 100] ^= 0xFF
    left_behind(tmp_path / "runs", run__mcap__partial=bytes(content))

    (done,) = recover(tmp_path / "runs").folders
    assert len(read_case(done / "run.mcap").rows) == 80
    assert "run: 20 rows are damaged and missing: 0.0" in summary_of(done)["cause"]


def test_a_damaged_recording_does_not_prevent_the_recovery_of_others(tmp_path, recorded, make_rows):
    content = recorded(make_rows(100), "good").read_bytes()
    folder = left_behind(tmp_path / "runs", good__mcap=content, bad__mcap=content[:-100], worse__mcap=bytes(5000))
    (folder / f"odd.mcap{PARTIAL_SUFFIX}").write_bytes(b"of another program")

    (done,) = recover(tmp_path / "runs").folders
    cases = summary_of(done)["cases"]
    assert cases["good"] == {"completed": True, "cause": ""}
    assert len(read_case(done / "bad.mcap").rows) == 100
    assert "damaged" in cases["worse"]["cause"]
    assert "odd.mcap.partial cannot be read" in summary_of(done)["cause"]
    assert (done / f"odd.mcap{PARTIAL_SUFFIX}").read_bytes() == b"of another program"


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", None])
def test_the_recovery_of_an_empty_recording_removes_its_folder(tmp_path, content):
    files = {} if content is None else {"run__mcap__partial": content}
    folder = left_behind(tmp_path, experiment__toml=b"title = 'x'", **files)
    (folder / "cameras").mkdir()

    assert recover(tmp_path) == ([], [])
    assert list(tmp_path.iterdir()) == []


def test_a_note_in_the_folder_of_an_empty_run_is_kept(tmp_path):
    left_behind(tmp_path, run__mcap__partial=b"", thesis__txt=b"the only copy")

    (done,) = recover(tmp_path).folders
    assert (done / "thesis.txt").read_bytes() == b"the only copy"
    assert summary_of(done)["label"] == "interrupted"


#: Files and folders of the user with names like ours; a None is a folder.
USERS = {
    "folder": {"thesis.partial": None, "thesis.partial/thesis.txt": b"the only copy"},
    "empty folder": {"thesis.partial": None},
    "names of a run": {"a.partial/experiment.toml": b"", "a.partial/summary.json": b"{}", "a.partial/cameras": None},
    "a recording": {"a.partial/run.mcap.partial": b"ours"},
    "file": {"x.partial": b"left by an export"},
    "only a suffix": {".partial/x.mcap": b"ours", f".partial/{MARK_FILE}": b"ctr-station"},
    "a mark of another program": {"a.partial/run.mcap.partial": b"ours", f"a.partial/{MARK_FILE}": b"something else"},
    "a video of another program": {"a/cameras/x.mcap.partial": b"film", "a/cameras/y.mcap.full": b""},
    "another folder": {"runs/one.partial/run.mcap.partial": b"ours"},
}


@pytest.mark.parametrize("names", USERS.values(), ids=USERS)
def test_files_of_the_user_with_names_like_ours_are_not_touched(tmp_path, unfinished, names):
    content, runs = unfinished(), tmp_path / "runs"
    left_behind(runs, run__mcap__partial=content)
    for name, put in names.items():
        path = runs / name
        if put is None:
            path.mkdir(parents=True)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if put == b"ours" else put)
    before = {path: kept for path, kept in everything(runs).items() if not path.startswith("one.partial")}

    assert recover(runs) == ([runs / "one"], [])
    assert {path: kept for path, kept in everything(runs).items() if path.split("/")[0] != "one"} == before


def test_hidden_files_next_to_a_recording_are_neither_recovered_nor_read(tmp_path, unfinished):
    folder = left_behind(tmp_path / "runs", run__mcap__partial=unfinished())
    for name in ("._run.mcap", "._run.mcap.partial"):
        (folder / name).write_bytes(b"\0\5\26\7 of macOS")

    (done,) = recover(tmp_path / "runs").folders
    assert [path.name for path in recordings(done)] == ["run.mcap"]
    assert (done / "._run.mcap.partial").read_bytes() == b"\0\5\26\7 of macOS"


def test_a_recovery_without_disk_space_changes_nothing_and_can_be_repeated(tmp_path, unfinished):
    content = unfinished()
    folder = left_behind(tmp_path / "runs", run__mcap__partial=content)
    before = everything(tmp_path / "runs")
    with full_disk(len(content) // 2):
        found = recover(tmp_path / "runs")
    assert found.folders == []
    assert f"{folder}: interrupted, and not recovered: File too large. Nothing of it is lost" in found.problems[0]
    assert everything(tmp_path / "runs") == before

    assert recover(tmp_path / "runs").folders == [tmp_path / "runs" / "one"]
    assert len(read_case(tmp_path / "runs" / "one" / "run.mcap").rows) == 100


def test_a_recovery_keeps_disk_space_free_for_a_run_that_is_recorded(tmp_path, unfinished, monkeypatch):
    content = unfinished()
    left_behind(tmp_path / "runs", run__mcap__partial=content)
    free = len(content) + int(FREE_SPACE_BYTES)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free - 1))
    assert "No space left on device. Nothing of it is lost" in recover(tmp_path / "runs").problems[0]

    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert recover(tmp_path / "runs").problems == []


def test_a_recording_belongs_to_its_writer_until_it_has_its_final_name(tmp_path, open_case_in, make_rows, monkeypatch):
    folder, writer = open_case_in(tmp_path)
    writer.write(make_rows(20))
    folder.let_go()
    assert recover(tmp_path) == ([], [])
    flush, found = os.fsync, list[Recovery]()

    def flushed(descriptor: int) -> None:
        flush(descriptor)
        found.append(recover(tmp_path))

    monkeypatch.setattr(os, "fsync", flushed)  # another program recovers while the end of the file is being flushed
    writer.close(RunOutcome.COMPLETE)
    monkeypatch.undo()
    assert found == [([], [])]
    assert read_case(folder.partial / "run.mcap").label is RunOutcome.COMPLETE


def test_copies_that_a_killed_recovery_left_behind_are_removed(tmp_path, unfinished):
    content = unfinished()
    folder = left_behind(tmp_path / "runs", run__mcap__partial=content)
    for name, copy in (("0" * 16, content[:5000]), ("1" * 16, b""), ("2" * 16, b"of the user"), ("3", content)):
        (folder / f".run.mcap.partial-{name}.partial").write_bytes(copy)

    (done,) = recover(tmp_path / "runs").folders
    kept = {f".run.mcap.partial-{name}.partial" for name in ("2" * 16, "3")}
    assert {path.name for path in done.iterdir()} == {"run.mcap", "summary.json", *kept}


def test_a_recovery_overwrites_no_recording_and_no_run(tmp_path, unfinished):
    content = unfinished()
    left_behind(tmp_path / "runs", run__mcap__partial=content, run__mcap__full=content, run__mcap=b"kept")
    (tmp_path / "runs" / "one").mkdir()

    (done,) = recover(tmp_path / "runs").folders
    assert done.name == "one-2"
    assert (done / "run.mcap").read_bytes() == b"kept"
    assert {len(read_case(done / name).rows) for name in ("run-2.mcap", "run-3.mcap")} == {100}


@pytest.mark.parametrize(
    "command",
    [
        ("export", "latest", "--format", "csv"), ("report", "latest"), ("replay", "latest"),
        ("export", "latest", "--dataset"),
    ],
    ids=lambda command: " ".join(command),
)  # fmt: skip
def test_a_folder_of_the_user_survives_every_command(tmp_path, unfinished, call, command):
    runs = tmp_path / "runs"
    left_behind(runs, run__mcap__partial=unfinished())
    (runs / "thesis.partial").mkdir()
    (runs / "thesis.partial" / "thesis.txt").write_text("the only copy", encoding="utf-8")
    (runs / f"x{PARTIAL_SUFFIX}").write_bytes(b"left by an export")
    (runs / f"y{FULL_SUFFIX}").write_bytes(b"")

    call("--data", str(runs), *command)
    assert (runs / "one" / "run.mcap").is_file()
    assert (runs / "thesis.partial" / "thesis.txt").read_text(encoding="utf-8") == "the only copy"
    assert (runs / f"x{PARTIAL_SUFFIX}").read_bytes() == b"left by an export"
