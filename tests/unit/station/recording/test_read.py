"""Recordings are read back with their resolution; invalid files are refused by name."""

import numpy as np
import pytest
from mcap.writer import Writer

from station.recording.read import missing_rows, open_case, read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from tests.harness.recordings import as_recorded


def test_recorded_rows_are_read_back_with_the_resolution_of_their_unit_whole_and_in_blocks(
    recorded, make_rows, channels
):
    rows = make_rows(330)
    path = recorded(rows, seed=4, lab={"title": "x"})
    rows = as_recorded(rows, channels.all)
    read = read_case(path)

    assert np.array_equal(read.rows, rows)
    assert read.channels == channels.all
    assert (read.metadata["seed"], read.metadata["lab"]) == (4, {"title": "x"})
    with open_case(path) as case:
        assert case.ticks == 330
        blocks = list(case.blocks())
    assert [len(block) for block in blocks] == [100, 100, 100, 30]
    assert (np.concatenate(blocks) == rows).all()


@pytest.mark.parametrize(("most", "stride"), [(330, 1), (329, 2), (164, 3), (1, 330)])
def test_a_long_recording_is_decimated_on_request(recorded, make_rows, most, stride):
    rows = make_rows(330)
    read = read_case(recorded(rows), most)

    assert (read.rows == as_recorded(rows, read.channels)[::stride]).all()
    assert len(read.rows) <= most


def test_a_recording_that_is_being_written_is_refused(open_writer, make_rows, tmp_path):
    writer = open_writer()
    writer.write(make_rows(10))
    with pytest.raises(RecordingError, match=r"one\.mcap\.partial: "):
        read_case(tmp_path / "one.mcap.partial")
    writer.close(RunOutcome.COMPLETE)


def test_an_invalid_recording_is_refused_by_name(tmp_path):
    (tmp_path / "text.mcap").write_text("rows: 12", encoding="utf-8")
    with (tmp_path / "other.mcap").open("wb") as file:
        other = Writer(file)
        other.start()
        other.finish()
    for name in ("text", "other", "missing"):
        with pytest.raises(RecordingError, match=f"{name}.mcap"):
            read_case(tmp_path / f"{name}.mcap")


def test_a_flipped_bit_in_a_recording_is_detected(recorded, make_rows):
    path = recorded(make_rows(100))
    content = bytearray(path.read_bytes())
    # The flipped bit is in the only chunk, which is most of the file.
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    read = read_case(path)
    assert len(read.rows) == 0
    assert missing_rows(read.gaps) == "100 rows are damaged and missing: all"


def test_an_exception_of_the_calling_code_is_not_reported_as_a_damaged_recording(recorded, make_rows):
    with pytest.raises(ValueError, match="my own"), open_case(recorded(make_rows(10))):
        raise ValueError("my own")
