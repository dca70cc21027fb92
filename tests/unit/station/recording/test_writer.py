"""A recording as the format's own reader sees it."""

import json

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros1.decoder import DecoderFactory

from station.recording.events import ERROR, Event
from station.recording.label import Label, RecordingError
from station.recording.read import read_case
from station.recording.recover import recover_file
from station.recording.writer import FULL
from tests.harness.full_disk import full_disk


def messages(path, topic):
    with path.open("rb") as file:
        return list(make_reader(file, validate_crcs=True).iter_messages(topics=topic))


def test_another_reader_finds_every_row_with_its_time(recorded, make_rows, channels):
    rows = make_rows(250)
    path = recorded(rows)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages(topics="/telemetry"))

    assert len(found) == 250
    for row, one in zip(rows, found, strict=True):
        assert one.decoded_message.time == row[0]
        assert one.decoded_message.stability == row[-1] or channels.all[-1].name != "stability"
        assert one.decoded_message.force.z == channels.of(row, "force")[2]
    stamps = np.array([one.message.log_time for one in found])
    assert np.diff(stamps) == pytest.approx(2e6, abs=1.0)
    assert [one.message.sequence for one in found] == list(range(250))


def test_the_index_says_what_a_walk_through_the_file_finds(recorded, make_rows):
    path = recorded(make_rows(250))
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    with path.open("rb") as file:
        walked = [channel.topic for _, channel, _ in NonSeekingReader(file, validate_crcs=True).iter_messages()]

    counts = summary.statistics.channel_message_counts
    assert {summary.channels[number].topic: count for number, count in counts.items() if count} == {
        topic: walked.count(topic) for topic in set(walked)
    }
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 4  # the last one has pictures only
    assert summary.statistics.message_count == len(walked)


def test_well_known_topics_come_10_times_a_second(recorded, make_rows):
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


def test_events_come_back_in_time_and_as_log_lines(open_writer, make_rows):
    writer = open_writer()
    late, early = Event(0.30, "fault", "coil lost", ERROR, {"device": "tracker"}), Event(0.10, "state", "RUNNING")
    writer.event(late)
    writer.write(make_rows(100))
    writer.event(early)
    writer.write(make_rows(100, 100))
    writer.close(Label.STOPPED, "a fault")

    assert read_case(writer.path).events == (early, late)
    schema, _, message = messages(writer.path, "/events")[1]
    line = json.loads(message.data)
    assert schema.name == "foxglove.Log"
    assert (line["message"], line["name"], line["level"]) == ("coil lost", "fault", 4)
    assert line["timestamp"]["sec"] * 10**9 + line["timestamp"]["nsec"] == message.log_time


def test_events_are_kept_without_any_row_and_after_the_last(open_writer, make_rows):
    writer = open_writer()
    writer.event(Event(0.0, "state", "READY"))
    writer.write(make_rows(0))
    writer.write(make_rows(10))
    writer.event(Event(1.0, "state", "HOLD"))
    writer.close(Label.STOPPED)

    assert [event.text for event in read_case(writer.path).events] == ["READY", "HOLD"]


def test_a_recording_of_nothing_opens(open_writer, channels):
    writer = open_writer()
    writer.close(Label.STOPPED, "nothing moved")
    read = read_case(writer.path)

    assert read.rows.shape == (0, len(channels))
    assert (read.label, read.cause) == (Label.STOPPED, "nothing moved")


def test_a_file_that_is_there_already_is_never_overwritten(open_writer):
    writer = open_writer()
    with pytest.raises(RecordingError, match="File exists"):
        open_writer()
    writer.close(Label.COMPLETE)


def test_after_its_end_nothing_can_be_written(open_writer, make_rows):
    writer = open_writer()
    writer.close(Label.COMPLETE)
    with pytest.raises(RecordingError, match="has ended"):
        writer.write(make_rows(1))


def fill(writer, make_rows) -> tuple[int, str]:
    """How many rows the disk took, and what was said then."""
    written = 0
    try:
        while True:
            writer.write(make_rows(100, written))
            written += 100
    except RecordingError as error:
        return written, str(error)


def test_a_full_disk_ends_the_recording_as_incomplete_with_every_chunk_before(open_writer, make_rows, tmp_path):
    limits = range(400_000, 500_000, 7_000)
    finished = 0
    for limit in limits:
        writer = open_writer(str(limit))
        with full_disk(limit):
            written, said = fill(writer, make_rows)
        assert "the disk takes no more of the recording: File too large" in said
        path = tmp_path / f"{limit}.mcap"
        finished += path.exists()
        if not path.exists():
            # There was no room for the end either.
            assert recover_file(tmp_path / f"{limit}.mcap{FULL}") == path
        read = read_case(path)
        assert read.label is Label.INCOMPLETE
        assert len(read.rows) == written > 0
    assert 0 < finished < len(limits)
