"""Recordings that end anywhere or are damaged anywhere keep every intact chunk and lose no byte."""

import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader

from station.recording.foxglove import RecordedEvent
from station.recording.metadata import texts
from station.recording.read import END_DAMAGED, Gap, open_case, read_case
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.salvage import DAMAGED, salvage
from tests.harness.recordings import as_recorded

GONE = texts({"label": RunOutcome.INTERRUPTED, "cause": "gone"})
#: Chunks of the recording, and rows of a chunk.
CHUNKS, ROWS = 5, 20


@pytest.fixture(scope="module")
def parts(tmp_path_factory, paper, channels, make_rows):
    """Return an unfinished and a finished recording, the offset of the end of each chunk, and the recorded rows."""
    from station.recording.writer import CaseWriter

    folder = tmp_path_factory.mktemp("recorded")
    writer = CaseWriter(folder / "left.mcap", paper.robot(), channels.all, {"seed": 1})
    partial = folder / "left.mcap.partial"
    ends = [partial.stat().st_size]
    rows = [make_rows(ROWS, ROWS * number) for number in range(CHUNKS)]
    for number, block in enumerate(rows):
        writer.event(RecordedEvent(float(block[0, 0]), "state", f"event {number}"))
        writer.write(block)
        ends.append(partial.stat().st_size)
    content = partial.read_bytes()
    writer.close(RunOutcome.COMPLETE)
    return content, (folder / "left.mcap").read_bytes(), ends, as_recorded(np.concatenate(rows), channels.all)


def salvaged(path, content, result=GONE):
    """Write the bytes and a complete copy of them; return the copy's path."""
    path.write_bytes(content)
    copy = path.with_name(f"copy-{path.name}")
    with path.open("rb") as source, copy.open("wb") as target:
        salvage(source, target, result)
    return copy


def flipped(content, at, by=0xFF):
    return content[:at] + bytes([content[at] ^ by]) + content[at + 1 :]


def check_rows(read, rows, lost):
    """Check that exactly the rows of some chunks are lost."""
    intact = np.array([number // ROWS not in lost for number in range(len(rows))])
    assert (read.rows == rows[intact]).all()
    assert {event.text for event in read.events} == {f"event {n}" for n in range(CHUNKS) if n not in lost}


def readers_agree(path):
    """Check that a reader with and one without the index find the same messages."""
    with path.open("rb") as file:
        seeking = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file, validate_crcs=True).iter_messages()]
    with path.open("rb") as file:
        walked = [(c.topic, m.log_time, m.data) for _, c, m in NonSeekingReader(file, True).iter_messages()]
    assert seeking == walked


def test_complete_chunks_of_a_recording_are_recovered_wherever_the_file_was_cut(parts, tmp_path):
    content, _, ends, rows = parts
    cuts = [*ends, *(end + 1 for end in ends[:-1]), *(end - 1 for end in ends[1:])]
    cuts += random.Random(1).sample(range(ends[0], len(content)), 10)
    for cut in cuts:
        copy = salvaged(tmp_path / "cut.mcap", content[:cut])
        read = read_case(copy)
        whole = max(number for number, end in enumerate(ends) if end <= cut)
        # A chunk is also complete if only its index was cut.
        assert len(read.rows) in (ROWS * whole, ROWS * (whole + 1))
        assert (read.rows == rows[: len(read.rows)]).all()
        assert read.label is RunOutcome.INTERRUPTED
        readers_agree(copy)


@pytest.mark.parametrize("finished", [False, True], ids=["unfinished", "finished"])
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_a_flipped_byte_in_a_chunk_loses_this_chunk_only(parts, chunk, finished, tmp_path):
    left, whole, ends, rows = parts
    (length,) = struct.unpack_from("<Q", left, ends[chunk] + 1)
    header = range(ends[chunk], ends[chunk] + 53)  # of the record and of the chunk
    inside = random.Random(chunk).sample(range(header.stop, ends[chunk] + 9 + length), 5)
    for at in (*header, *inside):
        path = tmp_path / "flipped.mcap"
        if finished:
            path.write_bytes(flipped(whole, at))
        else:
            path = salvaged(path, flipped(left, at))
            readers_agree(path)
        read = read_case(path)
        if len(read.rows) == len(rows):  # the byte was one of those that are computed again, for example a time
            assert at in header
            check_rows(read, rows, ())
        else:
            check_rows(read, rows, {chunk})


def test_the_gap_of_a_damaged_chunk_has_its_rows_and_times(parts, tmp_path):
    left, whole, ends, _ = parts
    for chunk, expected in (
        (0, Gap(ROWS, None, 0.04)),
        (2, Gap(ROWS, pytest.approx(0.078), pytest.approx(0.12))),
        (CHUNKS - 1, Gap(ROWS, pytest.approx(0.158), None)),
    ):
        at = (ends[chunk] + ends[chunk + 1]) // 2
        (tmp_path / "whole.mcap").write_bytes(flipped(whole, at))
        assert read_case(tmp_path / "whole.mcap").gaps == (expected,)
        gaps = read_case(salvaged(tmp_path / "left.mcap", flipped(left, at))).gaps
        assert gaps == ((expected,) if chunk < CHUNKS - 1 else ())  # nothing shows how many rows were written last


def test_several_damaged_chunks_are_several_gaps_and_events_after_them_are_kept(parts, tmp_path):
    left, _, ends, rows = parts
    spoilt = flipped(flipped(left, (ends[1] + ends[2]) // 2), (ends[3] + ends[4]) // 2)
    read = read_case(salvaged(tmp_path / "two.mcap", spoilt))

    check_rows(read, rows, {1, 3})
    assert [gap.rows for gap in read.gaps] == [ROWS, ROWS]


@given(st.data())
def test_bytes_that_are_overwritten_inserted_or_removed_leave_the_other_chunks_intact(parts, tmp_path_factory, data):
    left, whole, ends, rows = parts
    content = data.draw(st.sampled_from([left, whole]), "recording")
    start = data.draw(st.integers(ends[0], len(content) - 1), "start")
    end = data.draw(st.integers(start, min(start + 400, len(content))), "end")
    put = data.draw(st.binary(max_size=300) | st.builds(bytes, st.integers(0, 300)), "new bytes")
    damaged = content[:start] + put + content[end:]
    folder = tmp_path_factory.mktemp("damaged")
    first = salvaged(folder / "one.mcap", damaged)
    touched = {n for n in range(CHUNKS) if ends[n] < max(end, start + 1) and start < ends[n + 1]}
    for path in (first, salvaged(folder / "two.mcap", first.read_bytes())):  # a recovery of the copy changes nothing
        found = {tuple(row) for row in read_case(path).rows.tolist()}
        for number, row in enumerate(rows.tolist()):
            assert tuple(row) in found or number // ROWS in touched
        assert len(found) <= len(rows)
    assert first.read_bytes() == (folder / "copy-two.mcap").read_bytes()


def test_damaged_bytes_are_kept_in_a_record_that_readers_skip(parts, tmp_path):
    left, _, ends, _ = parts
    copy = salvaged(tmp_path / "kept.mcap", flipped(left, (ends[2] + ends[3]) // 2)).read_bytes()
    at = copy.index(bytes([DAMAGED]) + struct.pack("<Q", ends[3] - ends[2]))
    assert copy[at + 9 : at + 9 + ends[3] - ends[2]] == flipped(left, (ends[2] + ends[3]) // 2)[ends[2] : ends[3]]


def test_a_copy_of_a_recording_that_was_finished_or_cut_in_its_end_is_the_finished_recording(parts, tmp_path):
    left, whole, _, _ = parts
    assert salvaged(tmp_path / "whole.mcap", whole).read_bytes() == whole
    result = whole.index(b"result") + 200  # after the record of the outcome
    for cut in random.Random(2).sample(range(result, len(whole)), 8):
        assert salvaged(tmp_path / "cut.mcap", whole[:cut]).read_bytes() == whole
    assert len(left) < result


def test_a_finished_recording_with_a_damaged_or_missing_end_is_read(parts, tmp_path):
    _, whole, ends, rows = parts
    path = tmp_path / "end.mcap"
    for at in (ends[-1] + 20, *random.Random(4).sample(range(ends[-1], len(whole)), 40), len(whole) - 1):
        path.write_bytes(flipped(whole, at))
        read = read_case(path)
        assert (read.rows == rows).all()
        assert read.label in (RunOutcome.COMPLETE, RunOutcome.INTERRUPTED)
    path.write_bytes(whole[: len(whole) // 2])
    read = read_case(path)
    assert (read.label, read.cause) == (RunOutcome.INTERRUPTED, END_DAMAGED)
    assert 0 < len(read.rows) < len(rows)
    with open_case(path) as case:
        assert (np.concatenate(list(case.blocks())) == read.rows).all()


def test_the_recovery_skips_garbage_after_the_last_chunk(parts, tmp_path):
    content, _, _, rows = parts
    for rubbish in (bytes(5000), b"\x06" + b"\xff" * 200, random.Random(3).randbytes(3000), b"\x04\0\0\0zstd" * 500):
        copy = salvaged(tmp_path / "rubbish.mcap", content + rubbish)
        check_rows(read_case(copy), rows, ())
        readers_agree(copy)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"PNG, say, or anything else", bytes(5000)])
def test_a_file_without_the_first_bytes_of_a_recording_is_refused(content, tmp_path):
    path = tmp_path / "nothing.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"nothing\.mcap: not a recording of this program"):
        read_case(path)
