"""Rows as messages, decoded by independent decoders."""

import numpy as np
from mcap.records import Schema
from mcap_ros1.decoder import DecoderFactory

from station.control.telemetry import Channel
from station.recording.data_section import MESSAGE_HEADER_BYTES, definition, message_records
from station.recording.data_section import TELEMETRY_SCHEMA as SCHEMA


def decoded(channels: list[Channel], row: np.ndarray) -> object:
    schema = Schema(id=1, name=SCHEMA, encoding="ros1msg", data=definition(channels).encode())
    decoder = DecoderFactory().decoder_for("ros1", schema)
    assert decoder is not None
    return decoder(row.astype("<f8").tobytes())


def test_an_independent_ros_decoder_finds_every_channel_by_group_and_name(channels):
    row = np.arange(len(channels), dtype=float) + 0.125
    message = decoded(list(channels.all), row)

    for value, channel in zip(row, channels.all, strict=True):
        found = message
        for part in channel.name.split("."):
            found = getattr(found, part if part.isidentifier() else f"c_{part}")
        assert found == value


def test_names_that_are_invalid_in_ros_are_converted_and_unique():
    channels = [Channel(name, "") for name in ("time", "joints.a-b", "joints.a_b", "joints.2nd", "x y", "deep.er.one")]
    message = decoded(channels, np.arange(6.0))

    assert (message.time, message.joints.a_b, message.joints.a_b_2, message.joints.c_2nd) == (0.0, 1.0, 2.0, 3.0)
    assert (message.x_y, message.deep_er.one) == (4.0, 5.0)


def test_the_ros_message_definition_of_a_row_has_the_units(channels):
    lines = definition(channels.all).splitlines()

    assert "float64 time  # [s]" in lines
    assert "float64 state" in lines
    assert "float64 inner_mz  # [N m]" in lines


def test_message_records_have_the_layout_of_mcap():
    rows = np.array([[0.5, -1.0], [np.pi, 1e300]])
    made = message_records(rows, np.array([7, 9], np.uint64), topic=3, first=40)
    size = MESSAGE_HEADER_BYTES + 16

    assert made.offsets.tolist() == [0, size]
    for number, record in enumerate((made.records[:size], made.records[size:])):
        assert record[0] == 5  # opcode of a message
        assert int.from_bytes(record[1:9], "little") == size - 9
        assert int.from_bytes(record[9:11], "little") == 3
        assert int.from_bytes(record[11:15], "little") == 40 + number
        assert int.from_bytes(record[15:23], "little") == int.from_bytes(record[23:31], "little") == (7, 9)[number]
        assert np.frombuffer(record[31:], "<f8").tolist() == rows[number].tolist()
