"""Single rows are written to the disk in blocks."""

import numpy as np

from station.recording.case_recorder import BLOCK_ROWS, CaseRecorder
from station.recording.events import RecordedEvent
from station.recording.read import open_case, read_case
from station.recording.run_outcome import RunOutcome


def test_the_case_recorder_writes_a_full_block_of_rows_to_the_disk_at_once(open_writer, make_rows, channels, tmp_path):
    recorder = CaseRecorder(open_writer(), len(channels))
    partial = tmp_path / "one.mcap.partial"
    # Two blocks of rows: on a busy computer the first block may be written before it is full.
    rows, empty = make_rows(2 * BLOCK_ROWS), partial.stat().st_size
    for row in rows:
        recorder.write(row)
    assert partial.stat().st_size > empty + BLOCK_ROWS * len(channels) * 4
    recorder.close(RunOutcome.COMPLETE)


def test_the_case_recorder_records_every_row_once_if_the_caller_reuses_its_array(open_writer, make_rows, channels):
    writer = open_writer()
    recorder = CaseRecorder(writer, len(channels))
    rows = make_rows(2 * BLOCK_ROWS + 7)
    reused = np.empty(len(channels))
    for number, row in enumerate(rows):
        if number == BLOCK_ROWS:
            recorder.event(RecordedEvent(row[0], "state", "RUNNING"))
        reused[:] = row
        recorder.write(reused)
    recorder.close(RunOutcome.STOPPED, "enough")
    read = read_case(writer.path)

    assert (read.rows == rows).all()
    assert [event.text for event in read.events] == ["RUNNING"]
    assert (read.label, read.cause) == (RunOutcome.STOPPED, "enough")
    with open_case(writer.path) as case:
        assert max(len(block) for block in case.blocks()) <= BLOCK_ROWS
