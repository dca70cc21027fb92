"""Rows one at a time reach the disk in blocks."""

import numpy as np

from station.recording.case_recorder import BLOCK, CaseRecorder
from station.recording.events import Event
from station.recording.label import Label
from station.recording.read import open_case, read_case


def test_a_full_block_is_on_the_disk_without_being_asked(open_writer, make_rows, channels, tmp_path):
    recorder = CaseRecorder(open_writer(), len(channels))
    partial = tmp_path / "one.mcap.partial"
    # Twice as many: on a busy computer the first block may have gone before it was full.
    rows, empty = make_rows(2 * BLOCK), partial.stat().st_size
    for row in rows:
        recorder.write(row)
    assert partial.stat().st_size > empty + BLOCK * len(channels) * 4
    recorder.close(Label.COMPLETE)


def test_every_row_is_there_once_whatever_the_blocks_and_the_caller_may_use_its_row_again(
    open_writer, make_rows, channels
):
    writer = open_writer()
    recorder = CaseRecorder(writer, len(channels))
    rows = make_rows(2 * BLOCK + 7)
    reused = np.empty(len(channels))
    for number, row in enumerate(rows):
        if number == BLOCK:
            recorder.event(Event(row[0], "state", "RUNNING"))
        reused[:] = row
        recorder.write(reused)
    recorder.close(Label.STOPPED, "enough")
    read = read_case(writer.path)

    assert (read.rows == rows).all()
    assert [event.text for event in read.events] == ["RUNNING"]
    assert (read.label, read.cause) == (Label.STOPPED, "enough")
    with open_case(writer.path) as case:
        assert max(len(block) for block in case.blocks()) <= BLOCK
