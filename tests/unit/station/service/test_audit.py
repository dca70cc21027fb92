"""The audit log of requests and refusals, and the flight recorder, written to a real disk."""

import csv
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.service.audit import (
    AUDIT_FILE,
    KEPT_FILES,
    KEPT_ROWS,
    KEPT_SECONDS_FILES,
    LAST_SECONDS_FOLDER,
    Audit,
    AuditError,
    FlightRecorder,
)
from tests.harness.full_disk import full_disk


def test_audit_entries_are_returned_newest_first_and_survive_reopening(tmp_path: Path) -> None:
    log = Audit(tmp_path / "data")
    log.write("Anna (operator)", "POST /api/start", "10.0.0.1", "202")
    log.close()
    log = Audit(tmp_path / "data")
    log.write("Ben (viewer)", "POST /api/start", "10.0.0.2", '403: "viewers" may\nnot')
    newest, first = log.tail(10)
    log.close()
    assert (newest.who, newest.where) == ("Ben (viewer)", "10.0.0.2")
    assert newest.outcome == '403: "viewers" may\nnot'
    assert first.who == "Anna (operator)"
    assert first.time <= newest.time
    lines = (tmp_path / "data" / AUDIT_FILE).read_text().splitlines()
    assert [json.loads(line)["what"] for line in lines] == ["POST /api/start"] * 2


def test_audit_log_has_a_bounded_size_and_keeps_its_newest_entries(tmp_path: Path) -> None:
    log = Audit(tmp_path, limit=2000)
    for number in range(500):
        log.write("somebody", f"number {number}", "here", "x" * 10_000)
    newest = log.tail(3)
    log.close()
    assert [entry.what for entry in newest] == ["number 499", "number 498", "number 497"]
    files = list(tmp_path.glob("audit*"))
    assert len(files) <= KEPT_FILES + 1
    assert sum(file.stat().st_size for file in files) < (KEPT_FILES + 1) * 3000


def test_refusals_do_not_push_executed_requests_out_of_the_audit_log(tmp_path: Path) -> None:
    log = Audit(tmp_path, limit=2000)
    log.write("Anna (operator)", "POST /api/start", "10.0.0.1", "202")
    for number in range(500):
        log.refused("unknown", f"number {number}", "10.0.0.2", "403")
    log.write("Anna (operator)", "POST /api/stop", "10.0.0.1", "200")
    entries = log.tail(1000)
    log.close()
    assert [entry.what for entry in entries[:3]] == ["POST /api/stop", "number 499", "number 498"]
    assert entries[-1].what == "POST /api/start"


def test_audit_log_shared_by_two_stations_is_rotated_once(tmp_path: Path) -> None:
    one, other = Audit(tmp_path, limit=2000), Audit(tmp_path, limit=2000)
    for number in range(100):
        for log, name in ((one, "one"), (other, "other")):
            log.write(name, f"number {number}", "here", "x" * 80)
    one.close()
    other.close()
    kept = [path for path in sorted(tmp_path.glob("audit*")) if path.name != AUDIT_FILE]
    assert len(kept) == KEPT_FILES
    assert all(path.stat().st_size >= 2000 for path in kept)  # no file was rotated before it was full


@pytest.mark.parametrize("invalid", ['{"time": "yesterday"', '{"time": "2026-01-01T00:00:00"', '{"time": 7'])
def test_audit_line_with_an_invalid_time_or_cut_by_a_crash_is_skipped(tmp_path: Path, invalid: str) -> None:
    whole = ', "who": "a", "what": "b", "where": "c", "outcome": "d"}\n'
    (tmp_path / AUDIT_FILE).write_text(f'{invalid}{whole}{"[" * 9999}\n{{"time": "2026-01-01", "who": \n[]\n')
    log = Audit(tmp_path)
    log.write("a", "b", "c", "d")
    assert len(log.tail(5)) == 1
    log.close()


def test_audit_error_names_a_folder_whose_name_is_not_utf8(tmp_path: Path) -> None:
    with pytest.raises(AuditError, match=r"udcff.*must be UTF-8"):
        Audit(tmp_path / os.fsdecode(b"\xff"))


def test_audit_error_names_a_folder_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AuditError, match=r"file/audit\.jsonl"):
        Audit(tmp_path / "file")


def test_audit_log_is_created_again_after_its_folder_was_removed(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    log = Audit(folder)
    log.write("a", "before", "c", "d")
    shutil.rmtree(folder)
    log.write("a", "after", "c", "d")
    assert [entry.what for entry in log.tail(5)] == ["after"]
    log.close()


def test_audit_log_is_written_to_its_old_file_while_its_folder_cannot_be_created(tmp_path: Path) -> None:
    folder, away = tmp_path / "data", tmp_path / "away"
    log = Audit(folder)
    folder.rename(away)
    folder.write_text("in the way")
    log.write("a", "b", "c", "d")
    log.close()
    assert json.loads((away / AUDIT_FILE).read_text())["what"] == "b"


@pytest.mark.parametrize("kind", ["link", "FIFO", "folder"])
def test_audit_error_names_a_log_that_is_no_regular_file(tmp_path: Path, kind: str) -> None:
    path, elsewhere = tmp_path / "data" / AUDIT_FILE, tmp_path / "elsewhere"
    path.parent.mkdir()
    elsewhere.write_text("x")
    {"link": lambda: path.symlink_to(elsewhere), "FIFO": lambda: os.mkfifo(path), "folder": path.mkdir}[kind]()
    with pytest.raises(AuditError, match=f"audit.jsonl: the audit log cannot be written: .* is a {kind}"):
        Audit(path.parent)
    assert elsewhere.read_text() == "x"


def test_audit_write_to_a_full_disk_does_not_raise(tmp_path: Path) -> None:
    log = Audit(tmp_path)
    with full_disk(8000):
        for _ in range(100):
            log.write("who", "what", "where", "x" * 400)
        log.close()
    assert (tmp_path / AUDIT_FILE).stat().st_size <= 8000


def test_tail_of_the_audit_log_includes_requests_after_the_clock_was_set_back(tmp_path: Path) -> None:
    log = Audit(tmp_path)
    log.write("Anna (operator)", "POST /api/stop", "10.0.0.1", "200")
    for number in range(50):
        log.refused("unknown", f"number {number}", "10.0.0.2", "403")
    later = (tmp_path / "refused.jsonl").read_text(encoding="utf-8").replace('"time": "20', '"time": "21')
    (tmp_path / "refused.jsonl").write_text(
        later, encoding="utf-8"
    )  # entry of a time when the computer's clock was 100 years ahead
    entries = [entry.what for entry in log.tail(20)]
    log.close()
    assert len(entries) == 20
    assert "POST /api/stop" in entries


@pytest.fixture
def channels(paper) -> Channels:
    return Channels(paper.robot())


@pytest.fixture
def ring(channels):
    ring = Ring(len(channels))
    for number in range(700):
        row = np.full(len(channels), float(number))
        row[0] = 0.002 * number
        ring.write(row)
    yield ring
    ring.close(remove=True)


def test_hold_adds_a_line_to_the_audit_log_and_a_file_with_the_last_second(ring, channels, tmp_path: Path) -> None:
    audit = Audit(tmp_path)
    recorder = FlightRecorder(ring, channels, audit, tmp_path, "session")
    recorder.state(State.RUNNING, "")
    recorder.state(State.HOLD, "the tracker\nhas gone")
    recorder.note("warning", "SCHED_FIFO is refused")
    recorder.close()
    lines = audit.tail(10)
    audit.close()

    assert [(line.who, line.what) for line in reversed(lines)] == [
        ("station", "state RUNNING"),
        ("station", "state HOLD"),
        ("station", "warning"),
    ]
    (kept,) = (tmp_path / LAST_SECONDS_FOLDER).iterdir()
    assert lines[1].outcome == f"the tracker\nhas gone (telemetry of the last second before it: {kept.name})"
    with kept.open() as file:
        assert file.readline() == "# the tracker has gone\n"
        rows = list(csv.reader(file))
    assert rows[0] == [channel.column for channel in channels.all]
    assert len(rows) == 1 + KEPT_ROWS
    assert [float(row[0]) for row in (rows[1], rows[-1])] == pytest.approx([0.4, 1.398])


def test_flight_recorder_keeps_only_its_newest_files_and_all_files_of_the_user(ring, channels, tmp_path: Path) -> None:
    names = ("._x.csv", "20250101-000000-001-hold copy.csv", "20250101-000000-hold.csv", "own.csv")
    mine = {tmp_path / LAST_SECONDS_FOLDER / name for name in names}
    folder = tmp_path / LAST_SECONDS_FOLDER / "20250101-000000-001-hold.csv"
    folder.mkdir(parents=True)
    for path in mine:
        path.write_text("mine")
    recorder = FlightRecorder(ring, channels, None, tmp_path, "20260101-120000")
    for number in range(KEPT_SECONDS_FILES + 5):
        recorder.state(State.FAULT, f"number {number}")
    recorder.close()
    found = set((tmp_path / LAST_SECONDS_FOLDER).iterdir())
    kept = sorted(found - mine - {folder})

    assert found > mine | {folder}
    assert len(kept) == KEPT_SECONDS_FILES
    assert kept[-1].read_text().startswith(f"# number {KEPT_SECONDS_FILES + 4}\n")


def test_audit_log_reports_a_folder_of_last_seconds_that_cannot_be_written(ring, channels, tmp_path: Path) -> None:
    (tmp_path / LAST_SECONDS_FOLDER).write_text("a file in its place")
    audit = Audit(tmp_path)
    recorder = FlightRecorder(ring, channels, audit, tmp_path, "session")
    recorder.state(State.HOLD, "cause")
    recorder.close()
    (line,) = audit.tail(1)
    audit.close()

    assert line.outcome.startswith("cause (telemetry of the last second before it cannot be written: ")


def test_flight_recorders_of_two_stations_do_not_overwrite_each_others_files(ring, channels, tmp_path: Path) -> None:
    for cause in ("of the one", "of the other"):
        recorder = FlightRecorder(ring, channels, None, tmp_path, "session")
        recorder.state(State.HOLD, cause)
        recorder.close()
    kept = sorted((tmp_path / LAST_SECONDS_FOLDER).iterdir())
    assert [path.read_text().splitlines()[0] for path in kept] == ["# of the one", "# of the other"]
