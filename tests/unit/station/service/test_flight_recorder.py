"""The flight recorder writes state changes, and the last second before a failure, to a real disk."""

import csv
from pathlib import Path

import numpy as np
import pytest

from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.service.audit import Audit
from station.service.flight_recorder import KEPT_FILES, KEPT_ROWS, LAST_SECONDS_FOLDER, FlightRecorder


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
    assert lines[1].outcome == f"the tracker\nhas gone (the last second before it: {kept.name})"
    with kept.open() as file:
        assert file.readline() == "# the tracker has gone\n"
        rows = list(csv.reader(file))
    assert rows[0] == [channel.column for channel in channels.all]
    assert len(rows) == 1 + KEPT_ROWS
    assert [float(row[0]) for row in (rows[1], rows[-1])] == pytest.approx([0.4, 1.398])


def test_flight_recorder_keeps_only_its_newest_files(ring, channels, tmp_path: Path) -> None:
    recorder = FlightRecorder(ring, channels, None, tmp_path, "session")
    for number in range(KEPT_FILES + 5):
        recorder.state(State.FAULT, f"number {number}")
    recorder.close()
    kept = sorted((tmp_path / LAST_SECONDS_FOLDER).iterdir())

    assert len(kept) == KEPT_FILES
    assert kept[-1].read_text().startswith(f"# number {KEPT_FILES + 4}\n")


def test_audit_log_reports_a_folder_of_last_seconds_that_cannot_be_written(ring, channels, tmp_path: Path) -> None:
    (tmp_path / LAST_SECONDS_FOLDER).write_text("a file in its place")
    audit = Audit(tmp_path)
    recorder = FlightRecorder(ring, channels, audit, tmp_path, "session")
    recorder.state(State.HOLD, "cause")
    recorder.close()
    (line,) = audit.tail(1)
    audit.close()

    assert line.outcome.startswith("cause (the last second before it could not be kept: ")


def test_flight_recorders_of_two_stations_do_not_overwrite_each_others_files(ring, channels, tmp_path: Path) -> None:
    for cause in ("of the one", "of the other"):
        recorder = FlightRecorder(ring, channels, None, tmp_path, "session")
        recorder.state(State.HOLD, cause)
        recorder.close()
    kept = sorted((tmp_path / LAST_SECONDS_FOLDER).iterdir())
    assert [path.read_text().splitlines()[0] for path in kept] == ["# of the one", "# of the other"]
