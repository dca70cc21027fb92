"""The audit log on a real disk."""

import json
import os
from pathlib import Path

import pytest

from station.service.audit import KEPT, NAME, Audit, AuditError
from tests.harness.full_disk import full_disk


def test_lines_come_back_newest_first_and_survive_a_reopening(tmp_path: Path) -> None:
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
    lines = (tmp_path / "data" / NAME).read_text().splitlines()
    assert [json.loads(line)["what"] for line in lines] == ["POST /api/start"] * 2


def test_its_size_is_bounded_and_the_newest_lines_stay(tmp_path: Path) -> None:
    log = Audit(tmp_path, limit=2000)
    for number in range(500):
        log.write("somebody", f"number {number}", "here", "x" * 10_000)
    newest = log.tail(3)
    log.close()
    assert [entry.what for entry in newest] == ["number 499", "number 498", "number 497"]
    files = list(tmp_path.glob("audit*"))
    assert len(files) <= KEPT + 1
    assert sum(file.stat().st_size for file in files) < (KEPT + 1) * 3000


def test_refusals_push_nothing_out_that_was_done(tmp_path: Path) -> None:
    log = Audit(tmp_path, limit=2000)
    log.write("Anna (operator)", "POST /api/start", "10.0.0.1", "202")
    for number in range(500):
        log.refused("unknown", f"number {number}", "10.0.0.2", "403")
    log.write("Anna (operator)", "POST /api/stop", "10.0.0.1", "200")
    told = log.tail(1000)
    log.close()
    assert [entry.what for entry in told[:3]] == ["POST /api/stop", "number 499", "number 498"]
    assert told[-1].what == "POST /api/start"


def test_two_stations_on_one_folder_turn_the_log_over_once(tmp_path: Path) -> None:
    one, other = Audit(tmp_path, limit=2000), Audit(tmp_path, limit=2000)
    for number in range(100):
        for log, name in ((one, "one"), (other, "other")):
            log.write(name, f"number {number}", "here", "x" * 80)
    one.close()
    other.close()
    kept = [path for path in sorted(tmp_path.glob("audit*")) if path.name != NAME]
    assert len(kept) == KEPT
    assert all(path.stat().st_size >= 2000 for path in kept)  # none was turned over before it was full


@pytest.mark.parametrize("spoilt", ['{"time": "yesterday"', '{"time": "2026-01-01T00:00:00"', '{"time": 7'])
def test_a_line_with_a_spoilt_time_is_passed_over(tmp_path: Path, spoilt: str) -> None:
    (tmp_path / NAME).write_text(
        spoilt + ', "who": "a", "what": "b", "where": "c", "outcome": "d"}\n' + "[" * 9999 + "\n"
    )
    log = Audit(tmp_path)
    log.write("a", "b", "c", "d")
    assert len(log.tail(5)) == 1
    log.close()


def test_a_folder_whose_name_is_no_text_is_named(tmp_path: Path) -> None:
    with pytest.raises(AuditError, match=r"udcff.*must be UTF-8"):
        Audit(tmp_path / os.fsdecode(b"\xff"))


def test_a_line_cut_off_by_a_crash_is_passed_over(tmp_path: Path) -> None:
    log = Audit(tmp_path)
    log.write("a", "b", "c", "d")
    log.close()
    with (tmp_path / NAME).open("a") as file:
        file.write('{"time": "2026-01-01", "who": \n[]\n')
    log = Audit(tmp_path)
    assert [entry.who for entry in log.tail(5)] == ["a"]
    log.close()


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AuditError, match=r"file/audit\.jsonl"):
        Audit(tmp_path / "file")


def test_a_full_disk_does_not_stop_who_writes(tmp_path: Path) -> None:
    log = Audit(tmp_path)
    with full_disk(8000):
        for _ in range(100):
            log.write("who", "what", "where", "x" * 400)
        log.close()
    assert (tmp_path / NAME).stat().st_size <= 8000


def test_what_was_done_since_the_clock_was_set_back_is_told_beside_refusals_of_before(tmp_path: Path) -> None:
    log = Audit(tmp_path)
    log.write("Anna (operator)", "POST /api/stop", "10.0.0.1", "200")
    for number in range(50):
        log.refused("unknown", f"number {number}", "10.0.0.2", "403")
    later = (tmp_path / "refused.jsonl").read_text(encoding="utf-8").replace('"time": "20', '"time": "21')
    (tmp_path / "refused.jsonl").write_text(later, encoding="utf-8")  # as if the clock had been 100 years ahead
    told = [entry.what for entry in log.tail(20)]
    log.close()
    assert len(told) == 20
    assert "POST /api/stop" in told
