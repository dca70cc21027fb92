"""Recordings are read back with their resolution; invalid files are refused by name."""

import errno
import io
import os

import numpy as np
import pytest
from mcap.writer import Writer

from station.recording.chunks import chunks_with
from station.recording.read import Gap, indexed, missing_rows, open_case, read_case
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


def test_only_the_first_gaps_of_a_badly_damaged_recording_are_named():
    text = missing_rows([Gap(5, float(number), number + 0.5) for number in range(12)])
    assert text.startswith("60 rows are damaged and missing: 0.000 to 0.500 s, 1.000 to 1.500 s, ")
    assert text.endswith("9.000 to 9.500 s, and 2 more gaps")


def test_rows_in_a_bad_sector_of_the_disk_are_missing_and_others_are_read(recorded, make_rows):
    class BadSector(io.BufferedReader):
        """File whose second chunk cannot be read."""

        bad = -1

        def read(self, size: int | None = -1, /) -> bytes:
            if self.tell() == self.bad:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return super().read(-1 if size is None else size)

    with BadSector(io.FileIO(recorded(make_rows(300)))) as file, indexed(file) as recording:
        file.bad = sorted(index.chunk_start_offset for index in recording.summary.chunk_indexes)[1]
        found = list(chunks_with(file, recording.summary, recording.topic("/telemetry")))
    assert [content is None for content in found] == [False, True, False]


def test_an_exception_of_the_calling_code_is_not_reported_as_a_damaged_recording(recorded, make_rows):
    with pytest.raises(ValueError, match="my own"), open_case(recorded(make_rows(10))):
        raise ValueError("my own")
