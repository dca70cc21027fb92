"""Recordings can be read with the reader of the mcap library."""

import json

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros1.decoder import DecoderFactory

from station.recording.foxglove import ERROR, RecordedEvent
from station.recording.read import open_case, read_case
from station.recording.recover import recover_file
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import BLOCK_ROWS, FULL_SUFFIX, CaseRecorder
from tests.harness.full_disk import full_disk
from tests.harness.recordings import as_recorded


def messages(path, topic):
    with path.open("rb") as file:
        return list(make_reader(file, validate_crcs=True).iter_messages(topics=topic))


def test_the_mcap_library_reads_every_recorded_row_with_its_time(recorded, make_rows, channels):
    rows = make_rows(250)
    path = recorded(rows)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages(topics="/telemetry"))

    assert len(found) == 250
    for row, one in zip(as_recorded(rows, channels.all), found, strict=True):
        assert one.decoded_message.time == row[0]
        assert one.decoded_message.stability == row[-1] or channels.all[-1].name != "stability"
        assert one.decoded_message.force.z == channels.of(row, "force")[2]
    stamps = np.array([one.message.log_time for one in found])
    assert np.diff(stamps) == pytest.approx(2e6, abs=1.0)
    assert [one.message.sequence for one in found] == list(range(250))


def test_the_index_of_a_recording_matches_the_records_of_the_file(recorded, make_rows):
    path = recorded(make_rows(250))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    with path.open("rb") as file:
        walked = [channel.topic for _, channel, _ in NonSeekingReader(file, validate_crcs=True).iter_messages()]

    counts = summary.statistics.channel_message_counts
    assert {summary.channels[number].topic: count for number, count in counts.items() if count} == {
        topic: walked.count(topic) for topic in set(walked)
    }
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 4  # the last chunk has only pictures
    assert summary.statistics.message_count == len(walked)


def test_drawing_topics_of_a_recording_have_10_messages_a_second(recorded, make_rows):
    path = recorded(make_rows(500))
    for topic, schema in (
        ("/tf", "foxglove.FrameTransforms"),
        ("/scene", "foxglove.SceneUpdate"),
        ("/tip/measured", "foxglove.PoseInFrame"),
    ):
        found = messages(path, topic)
        assert len(found) == 10
        assert {(one.name, one.encoding, channel.message_encoding) for one, channel, _ in found} == {
            (schema, "jsonschema", "json")
        }


def test_recorded_events_are_read_back_in_order_and_as_log_messages(open_writer, make_rows):
    writer = open_writer()
    late, early = (
        RecordedEvent(0.30, "fault", "coil lost", ERROR, {"device": "tracker"}),
        RecordedEvent(0.10, "state", "RUNNING"),
    )
    writer.event(late)
    writer.write(make_rows(100))
    writer.event(early)
    writer.write(make_rows(100, 100))
    writer.close(RunOutcome.STOPPED, "a fault")

    assert read_case(writer.path).events == (early, late)
    schema, _, message = messages(writer.path, "/events")[1]
    line = json.loads(message.data)
    assert schema.name == "foxglove.Log"
    assert (line["message"], line["name"], line["level"]) == ("coil lost", "fault", 4)
    assert line["timestamp"]["sec"] * 10**9 + line["timestamp"]["nsec"] == message.log_time


def test_events_without_rows_and_after_the_last_row_are_recorded(open_writer, make_rows):
    writer = open_writer()
    writer.event(RecordedEvent(0.0, "state", "READY"))
    writer.write(make_rows(0))
    writer.write(make_rows(10))
    writer.event(RecordedEvent(1.0, "state", "HOLD"))
    writer.close(RunOutcome.STOPPED)

    assert [event.text for event in read_case(writer.path).events] == ["READY", "HOLD"]


def test_an_existing_recording_is_never_overwritten(open_writer):
    writer = open_writer()
    with pytest.raises(RecordingError, match="File exists"):
        open_writer()
    writer.close(RunOutcome.COMPLETE)


def test_a_finished_recording_refuses_rows(open_writer, make_rows):
    writer = open_writer()
    writer.close(RunOutcome.COMPLETE)
    with pytest.raises(RecordingError, match="has ended"):
        writer.write(make_rows(1))


def fill(writer, make_rows) -> tuple[int, str]:
    """Return the number of written rows and the message of the error."""
    written = 0
    try:
        while True:
            writer.write(make_rows(100, written))
            written += 100
    except RecordingError as error:
        return written, str(error)


def test_a_full_disk_ends_the_recording_as_incomplete_and_keeps_every_complete_chunk(open_writer, make_rows, tmp_path):
    limits = range(400_000, 500_000, 14_000)
    finished = 0
    for limit in limits:
        writer = open_writer(str(limit))
        with full_disk(limit):
            written, message = fill(writer, make_rows)
        assert "the recording cannot be continued: File too large" in message
        path = tmp_path / f"{limit}.mcap"
        finished += path.exists()
        if not path.exists():
            # The disk had no space for the end of the file either.
            assert recover_file(tmp_path / f"{limit}.mcap{FULL_SUFFIX}") == path
        read = read_case(path)
        assert read.label is RunOutcome.INCOMPLETE
        assert len(read.rows) == written > 0
    assert 0 < finished < len(limits)


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
            writer.event(RecordedEvent(row[0], "state", "RUNNING"))
        reused[:] = row
        recorder.write(reused)
    recorder.close(RunOutcome.STOPPED, "enough")
    read = read_case(writer.path)

    assert (read.rows == as_recorded(rows, channels.all)).all()
    assert [event.text for event in read.events] == ["RUNNING"]
    assert (read.label, read.cause) == (RunOutcome.STOPPED, "enough")
    with open_case(writer.path) as case:
        assert max(len(block) for block in case.blocks()) <= BLOCK_ROWS
