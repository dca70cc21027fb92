"""Recovery of incomplete folders."""

import json

from station.recording.read import read_case
from station.recording.recover import recover
from station.recording.run_folder import RunFolder
from station.recording.run_outcome import RunOutcome
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX


def test_a_recording_that_a_full_disk_ended_is_recovered_as_incomplete(tmp_path, open_writer, make_rows):
    writer = open_writer("run")
    writer.write(make_rows(100))
    content = (tmp_path / "run.mcap.partial").read_bytes()
    writer.close(RunOutcome.COMPLETE)
    folder = tmp_path / "runs" / f"one{PARTIAL_SUFFIX}"
    folder.mkdir(parents=True)
    (folder / f"run.mcap{FULL_SUFFIX}").write_bytes(content)

    (done,) = recover(tmp_path / "runs")
    assert done == tmp_path / "runs" / "one"
    read = read_case(done / "run.mcap")
    assert (read.label, len(read.rows)) == (RunOutcome.INCOMPLETE, 100)
    summary = json.loads((done / "summary.json").read_text(encoding="utf-8"))
    assert (summary["label"], summary["cause"]) == ("incomplete", "the disk was full")


def test_a_damaged_recording_does_not_prevent_the_recovery_of_others(tmp_path, open_writer, make_rows):
    writer = open_writer("good")
    writer.write(make_rows(100))
    writer.close(RunOutcome.COMPLETE)
    content = (tmp_path / "good.mcap").read_bytes()
    folder = tmp_path / "runs" / f"one{PARTIAL_SUFFIX}"
    folder.mkdir(parents=True)
    (folder / "good.mcap").write_bytes(content)
    (folder / "bad.mcap").write_bytes(content[: len(content) // 2])
    (folder / "worse.mcap").write_bytes(b"\0" * 5000)

    (done,) = recover(tmp_path / "runs")
    cases = json.loads((done / "summary.json").read_text(encoding="utf-8"))["cases"]
    assert cases["good"] == {"completed": True, "cause": ""}
    assert all("damaged" in cases[name]["cause"] for name in ("bad", "worse"))
    assert len(read_case(done / "good.mcap").rows) == 100


def test_the_recovery_of_an_empty_recording_removes_its_folder(tmp_path):
    folder = RunFolder(tmp_path, "one")
    (folder.partial / "run.mcap.partial").write_bytes(b"")
    folder.let_go()

    assert recover(tmp_path) == []
    assert list(tmp_path.iterdir()) == []
