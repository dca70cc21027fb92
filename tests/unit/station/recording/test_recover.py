"""Folders that were left half-written."""

import json

from station.recording.label import Label
from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_folder import RunFolder
from station.recording.writer import FULL, PARTIAL


def test_what_the_disk_had_no_room_to_finish_is_incomplete(tmp_path, open_writer, make_rows):
    writer = open_writer("run")
    writer.write(make_rows(100))
    content = (tmp_path / "run.mcap.partial").read_bytes()
    writer.close(Label.COMPLETE)
    folder = tmp_path / "runs" / f"one{PARTIAL}"
    folder.mkdir(parents=True)
    (folder / f"run.mcap{FULL}").write_bytes(content)

    (done,) = recover(tmp_path / "runs")
    assert done == tmp_path / "runs" / "one"
    read = read_case(done / "run.mcap")
    assert (read.label, len(read.rows)) == (Label.INCOMPLETE, 100)
    summary = json.loads((done / "summary.json").read_text(encoding="utf-8"))
    assert (summary["label"], summary["cause"]) == ("incomplete", "the disk took no more")


def test_a_damaged_recording_does_not_keep_the_others_from_their_names(tmp_path, open_writer, make_rows):
    writer = open_writer("good")
    writer.write(make_rows(100))
    writer.close(Label.COMPLETE)
    content = (tmp_path / "good.mcap").read_bytes()
    folder = tmp_path / "runs" / f"one{PARTIAL}"
    folder.mkdir(parents=True)
    (folder / "good.mcap").write_bytes(content)
    (folder / "bad.mcap").write_bytes(content[: len(content) // 2])
    (folder / "worse.mcap").write_bytes(b"\0" * 5000)

    (done,) = recover(tmp_path / "runs")
    cases = json.loads((done / "summary.json").read_text(encoding="utf-8"))["cases"]
    assert cases["good"] == {"completed": True, "cause": ""}
    assert all("damaged" in cases[name]["cause"] for name in ("bad", "worse"))
    assert len(read_case(done / "good.mcap").rows) == 100


def test_a_recording_that_never_reached_the_disk_leaves_nothing(tmp_path):
    folder = RunFolder(tmp_path, "one")
    (folder.partial / "run.mcap.partial").write_bytes(b"")
    folder.let_go()

    assert recover(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_runs_that_is_not_there_needs_no_recovery(tmp_path):
    assert recover(tmp_path / "none") == []
