"""What the station writes down by itself, on a real disk from a real ring."""

import csv
from pathlib import Path

import numpy as np
import pytest

from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.service.audit import Audit
from station.service.flight_recorder import FOLDER, KEPT, ROWS, FlightRecorder


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


def test_a_hold_is_a_line_of_the_log_and_the_last_second_a_file(ring, channels, tmp_path: Path) -> None:
    audit = Audit(tmp_path)
    chronicle = FlightRecorder(ring, channels, audit, tmp_path, "session")
    chronicle.state(State.RUNNING, "")
    chronicle.state(State.HOLD, "the tracker\nhas gone")
    chronicle.note("warning", "SCHED_FIFO is refused")
    chronicle.close()
    lines = audit.tail(10)
    audit.close()

    assert [(line.who, line.what) for line in reversed(lines)] == [
        ("station", "state RUNNING"),
        ("station", "state HOLD"),
        ("station", "warning"),
    ]
    (kept,) = (tmp_path / FOLDER).iterdir()
    assert lines[1].outcome == f"the tracker\nhas gone (the last second before it: {kept.name})"
    with kept.open() as file:
        assert file.readline() == "# the tracker has gone\n"
        rows = list(csv.reader(file))
    assert rows[0] == [channel.column for channel in channels.all]
    assert len(rows) == 1 + ROWS
    assert [float(row[0]) for row in (rows[1], rows[-1])] == pytest.approx([0.4, 1.398])


def test_only_so_many_are_kept_the_newest(ring, channels, tmp_path: Path) -> None:
    chronicle = FlightRecorder(ring, channels, None, tmp_path, "session")
    for number in range(KEPT + 5):
        chronicle.state(State.FAULT, f"number {number}")
    chronicle.close()
    kept = sorted((tmp_path / FOLDER).iterdir())

    assert len(kept) == KEPT
    assert kept[-1].read_text().startswith(f"# number {KEPT + 4}\n")


def test_a_folder_that_cannot_be_written_is_said_in_the_log(ring, channels, tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("a file in its place")
    audit = Audit(tmp_path)
    chronicle = FlightRecorder(ring, channels, audit, tmp_path, "session")
    chronicle.state(State.HOLD, "cause")
    chronicle.close()
    (line,) = audit.tail(1)
    audit.close()

    assert line.outcome.startswith("cause (the last second before it could not be kept: ")


def test_two_stations_of_the_same_second_keep_both_their_last_seconds(ring, channels, tmp_path: Path) -> None:
    for cause in ("of the one", "of the other"):
        recorder = FlightRecorder(ring, channels, None, tmp_path, "session")
        recorder.state(State.HOLD, cause)
        recorder.close()
    kept = sorted((tmp_path / FOLDER).iterdir())
    assert [path.read_text().splitlines()[0] for path in kept] == ["# of the one", "# of the other"]
