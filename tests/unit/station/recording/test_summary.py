"""Recordings that end anywhere are recovered up to the last complete chunk."""

import random
import struct

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from station.recording.metadata import texts
from station.recording.read import read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.summary import finish_file
from tests.harness.recordings import as_recorded

GONE = texts({"label": RunOutcome.INTERRUPTED, "cause": "gone"})


@pytest.fixture
def left(open_writer, make_rows, tmp_path):
    """Return the bytes of an unfinished recording of five chunks, and the offset of the end of each chunk."""
    writer = open_writer("left")
    partial = tmp_path / "left.mcap.partial"
    ends = [partial.stat().st_size]
    for number in range(5):
        writer.write(make_rows(20, 20 * number))
        ends.append(partial.stat().st_size)
    content = partial.read_bytes()
    writer.close(RunOutcome.COMPLETE)
    return content, ends


def finished(path, content, result=GONE):
    path.write_bytes(content)
    finish_file(path, result, verify=True)
    return read_case(path)


def test_complete_chunks_of_a_recording_are_recovered_wherever_the_file_was_cut(left, make_rows, tmp_path):
    content, ends = left
    rows = make_rows(100)
    cuts = [*ends, *(end + 1 for end in ends[:-1]), *(end - 1 for end in ends[1:])]
    cuts += random.Random(1).sample(range(ends[0], len(content)), 10)
    for cut in cuts:
        read = finished(tmp_path / "cut.mcap", content[:cut])
        whole = max(number for number, end in enumerate(ends) if end <= cut)
        # A chunk is also complete if only its index was cut.
        assert len(read.rows) in (20 * whole, 20 * (whole + 1))
        written = np.concatenate([make_rows(20, 20 * n) for n in range(5)])
        assert (read.rows == as_recorded(written[: len(read.rows)], read.channels)).all()
        assert read.label is RunOutcome.INTERRUPTED
    assert len(rows) == 100


def test_the_recovery_keeps_and_indexes_a_chunk_without_its_index(left, tmp_path):
    content, ends = left
    # The record of the last chunk starts at the end of the previous one.
    length = struct.unpack_from("<Q", content, ends[-2] + 1)[0]
    after_chunk = ends[-2] + 9 + length
    assert after_chunk < ends[-1]
    whole = finished(tmp_path / "whole.mcap", content)
    for cut in (after_chunk, after_chunk + 5, after_chunk + 400, ends[-1] - 1):
        path = tmp_path / "cut.mcap"
        assert (finished(path, content[:cut]).rows == whole.rows).all()
        with path.open("rb") as file:
            seeking = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]
        with path.open("rb") as file:
            walked = [(c.topic, m.log_time, m.data) for _, c, m in NonSeekingReader(file).iter_messages()]
        assert seeking == walked


def test_a_damaged_chunk_ends_the_recording_before_it(left, tmp_path):
    content, ends = left
    middle = (ends[2] + ends[3]) // 2
    spoilt = content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :]

    assert len(finished(tmp_path / "spoilt.mcap", spoilt).rows) == 40


def test_finishing_a_recording_again_after_a_kill_gives_the_same_file(left, tmp_path):
    content, _ = left
    path = tmp_path / "again.mcap"
    whole = finished(path, content)
    done = path.read_bytes()
    for cut in random.Random(2).sample(range(len(content), len(done)), 8):
        assert (finished(path, done[:cut]).rows == whole.rows).all()
        assert path.read_bytes() == done


def test_the_outcome_written_into_a_recording_is_not_replaced(left, tmp_path):
    content, _ = left
    path = tmp_path / "stands.mcap"
    finished(path, content, texts({"label": RunOutcome.COMPLETE, "cause": ""}))
    assert finished(path, path.read_bytes()[:-20]).label is RunOutcome.COMPLETE


def test_the_recovery_drops_garbage_after_the_last_chunk(left, tmp_path):
    content, _ = left
    for rubbish in (bytes(5000), b"\x06" + b"\xff" * 200, random.Random(3).randbytes(3000)):
        assert len(finished(tmp_path / "rubbish.mcap", content + rubbish).rows) == 100


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"PNG, say, or anything else"])
def test_the_recovery_refuses_a_file_without_the_first_bytes_of_mcap(content, tmp_path):
    path = tmp_path / "nothing.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="does not start as an MCAP file"):
        finish_file(path, GONE, verify=True)
