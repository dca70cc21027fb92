"""Zaber messages: the manufacturer's bytes, units, error texts, and recovery of the frame in any stream."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.zaber.protocol import (
    BYTE_TIME_S,
    MESSAGE_TIME_S,
    ZaberError,
    ZaberMessage,
    ZaberParser,
    decode,
    encode,
    error_text,
    speed_data,
    split_id,
    top_speed,
    with_id,
)

#: Messages that were recorded on a real line, or that the manual lists as examples.
WORKED = [
    ("00 32 00 00 00 00", ZaberMessage(0, 50, 0)),
    ("01 32 45 11 00 00", ZaberMessage(1, 50, 4421)),
    ("03 32 ec 10 00 00", ZaberMessage(3, 50, 4332)),
    ("01 35 65 00 00 00", ZaberMessage(1, 53, 101)),
    ("01 ff 35 00 00 00", ZaberMessage(1, 255, 53)),
    ("01 3f e9 03 00 00", ZaberMessage(1, 63, 1001)),
    ("01 33 0b 02 00 00", ZaberMessage(1, 51, 523)),
    ("01 25 40 00 00 00", ZaberMessage(1, 37, 64)),
    ("01 16 ff ff ff ff", ZaberMessage(1, 22, -1)),
]
MESSAGES = st.builds(
    ZaberMessage, st.integers(0, 255), st.integers(0, 255), st.integers(min_value=-(1 << 31), max_value=(1 << 31) - 1)
)


@pytest.mark.parametrize(("text", "message"), WORKED)
def test_messages_match_the_worked_examples_in_both_directions(text, message):
    assert encode(message) == bytes.fromhex(text)
    assert decode(bytes.fromhex(text)) == message


@pytest.mark.parametrize(
    ("message", "part"),
    [((256, 1, 0), "device 256"), ((1, -1, 0), "command -1"), ((1, 20, 1 << 31), "data 2147483648")],
)
def test_value_outside_its_range_is_refused_by_name(message, part):
    with pytest.raises(ZaberError, match=part):
        encode(ZaberMessage(*message))


def test_message_id_uses_the_sixth_byte():
    # A public client sent `01 3c 00 00 00 01`: position, ID 1.
    assert encode(ZaberMessage(1, 60, with_id(0, 1))) == bytes.fromhex("01 3c 00 00 00 01")
    assert split_id(with_id(-77, 255)) == (-77, 255)
    assert split_id(with_id(8_388_607, 128)) == (8_388_607, 128)


def test_line_transmits_160_messages_per_second():
    assert pytest.approx(1 / 160) == MESSAGE_TIME_S
    assert pytest.approx(10 / 9600) == BYTE_TIME_S


@pytest.mark.parametrize(
    ("per_second", "microstep", "data"),
    [
        (3.0, 0.000234375, 1365),  # 3 deg/s
        (3.14, 0.49609375e-3, 675),  # 3.14 mm/s: peak speed of a sinusoid of 10 mm at 0.05 Hz
        (4.71, 0.49609375e-3, 1013),  # 4.71 mm/s: peak speed of a sinusoid of 15 mm at 0.05 Hz
        (-3.0, 0.000234375, -1365),
    ],
)
def test_speeds_are_converted_to_the_units_of_the_line(per_second, microstep, data):
    assert speed_data(per_second / microstep) == data


def test_speed_that_is_not_finite_is_refused():
    with pytest.raises(ZaberError, match="not finite"):
        speed_data(float("nan"))


def test_largest_speed_at_the_factory_resolution():
    assert top_speed(64) == 32767


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (255, "busy"),
        (64, "unknown command"),
        (22, "speed"),
        (44, "maximum"),
        (4016, "bit 16"),
        (999, "not in the list"),
    ],
)
def test_error_replies_have_texts(code, words):
    assert words in error_text(code)


@given(st.lists(MESSAGES, max_size=8), st.lists(st.integers(0, 48), max_size=12))
def test_messages_do_not_depend_on_the_split_of_the_stream(messages, cuts):
    stream = b"".join(map(encode, messages))
    edges = sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})
    parser, found = ZaberParser(), []

    for k, (start, end) in enumerate(pairwise(edges)):
        # A pause of 9 ms is the longest allowed pause between bytes.
        found += parser.feed(stream[start:end], k * 0.009)

    assert found == messages
    assert parser.dropped == 0


@given(st.binary(min_size=1, max_size=200), MESSAGES, st.integers(1, 5))
def test_message_after_a_silence_is_parsed_after_any_garbage(garbage, message, cut):
    parser, frame = ZaberParser(), encode(message)
    parser.feed(garbage, 0.0)

    found = parser.feed(frame[:cut], 0.0101) + parser.feed(frame[cut:], 0.0102)

    assert found == [message]
    assert parser.dropped == len(garbage) % 6


def test_message_with_too_long_a_pause_is_dropped():
    parser, frame = ZaberParser(), encode(ZaberMessage(1, 60, 1000))

    assert parser.feed(frame[:3], 0.0) == []
    assert parser.feed(frame[3:], 0.0105) == []
    assert parser.feed(frame, 0.0300) == [ZaberMessage(1, 60, 1000)]
    assert (parser.dropped, parser.resyncs) == (6, 2)


def test_long_interval_between_reads_is_not_taken_for_a_silence():
    parser, frame = ZaberParser(), encode(ZaberMessage(1, 60, 1000))
    parser.feed(frame[:3], 0.0)

    assert parser.feed(frame[3:], 0.5, since=0.002) == [ZaberMessage(1, 60, 1000)]


@given(st.binary(max_size=20).filter(lambda noise: 1 not in noise))
def test_next_valid_message_is_found_without_a_silence(noise):
    parser = ZaberParser(lambda message: message.device == 1 and message.command == 60)
    frame = encode(ZaberMessage(1, 60, 70_000))

    assert parser.feed(noise + frame, 0.0) == [ZaberMessage(1, 60, 70_000)]
    assert parser.dropped == len(noise)


def test_lost_byte_affects_one_message_only():
    parser = ZaberParser(lambda message: message[:2] == (1, 60) and 0 <= message.data <= 3_072_000)
    frame = encode(ZaberMessage(1, 60, 70_000))

    assert parser.feed(frame[:4] + frame[5:] + frame + frame, 0.0) == [ZaberMessage(1, 60, 70_000)] * 2
    assert (parser.dropped, parser.resyncs) == (5, 1)
