"""Rows as messages, decoded by independent decoders."""

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros1.decoder import DecoderFactory

from station.control.telemetry import Channel
from station.recording.data_section import TELEMETRY_SCHEMA as SCHEMA
from station.recording.data_section import Rounding, RowFormat


def decoded(rows: RowFormat, row: np.ndarray) -> object:
    schema = Schema(id=1, name=SCHEMA, encoding="ros1msg", data=rows.definition.encode())
    decoder = DecoderFactory().decoder_for("ros1", schema)
    assert decoder is not None
    return decoder(rows.pack(row[None]).tobytes())


@pytest.mark.parametrize("kind", [RowFormat, RowFormat.compact])
def test_an_independent_ros_decoder_finds_every_channel_by_group_and_name(channels, kind):
    row = np.arange(len(channels), dtype=float) + 0.125
    message = decoded(kind(channels.all), row)

    for value, channel in zip(row, channels.all, strict=True):
        found = message
        for part in channel.name.split("."):
            found = getattr(found, part if part.isidentifier() else f"c_{part}")
        assert found == value


def test_names_that_are_invalid_in_ros_are_converted_and_unique():
    channels = [Channel(name, "") for name in ("time", "joints.a-b", "joints.a_b", "joints.2nd", "x y", "deep.er.one")]
    message = decoded(RowFormat(channels), np.arange(6.0))

    assert (message.time, message.joints.a_b, message.joints.a_b_2, message.joints.c_2nd) == (0.0, 1.0, 2.0, 3.0)
    assert (message.x_y, message.deep_er.one) == (4.0, 5.0)


def test_the_ros_message_definition_of_a_row_has_the_units(channels):
    lines = RowFormat.compact(channels.all).definition.splitlines()

    assert "float64 time  # [s]" in lines
    assert "float32 state" in lines
    assert "float32 inner_mz  # [N m]" in lines
    assert "float64 state" in RowFormat(channels.all).definition.splitlines()


@pytest.mark.parametrize("count", [1, -2_097_153, 7_999_999, -8_000_000])
def test_a_recording_keeps_every_count_of_a_force_sensor_up_to_8_newtons(channels, count):
    rows = np.zeros((1, len(channels)))
    channels.of(rows, "wrench_raw")[:] = 1e-6 * count
    channels.of(rows, "tip_measured")[:] = 0.12345678
    packed = RowFormat.compact(channels.all)
    read = packed.unpack(packed.pack(Rounding(channels.all).rounded(rows)).tobytes())

    assert set(np.rint(channels.of(read, "wrench_raw")[0] / 1e-6).tolist()) == {float(count)}
    assert np.abs(channels.of(read, "tip_measured")[0] - 0.12345678).max() < 4e-9


def test_rounding_of_a_recording_does_not_change_the_given_rows(channels):
    rows = np.full((2, len(channels)), 1.0 / 3.0)
    rounded = Rounding(channels.all).rounded(rows)

    assert (rows == 1.0 / 3.0).all()
    assert 0.0 < abs(channels.of(rounded, "force")[0, 0] - 1.0 / 3.0) <= 2.0**-15
