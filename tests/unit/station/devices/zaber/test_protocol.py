"""Zaber messages: the manufacturer's bytes, units, error texts, and recovery of the frame in any stream."""

import random
import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.zaber.chain import Axis, LineSettings, ZaberChain
from station.devices.zaber.protocol import (
    BYTE_TIME_S,
    RESYNC_GAP_S,
    Request,
    ZaberError,
    ZaberMessage,
    ZaberParser,
    alias_number,
    decode,
    encode,
    error_text,
    safe_speed,
    speed_data,
    split_id,
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
    assert parser.dropped.count == 0


@given(st.binary(min_size=1, max_size=200), MESSAGES, st.integers(1, 5))
def test_message_after_a_silence_is_parsed_after_any_garbage(garbage, message, cut):
    parser, frame = ZaberParser(), encode(message)
    parser.feed(garbage, 0.0)

    found = parser.feed(frame[:cut], 0.0101) + parser.feed(frame[cut:], 0.0102)

    assert found == [message]
    assert parser.dropped.count == len(garbage) % 6


def test_message_with_too_long_a_pause_is_dropped():
    parser, frame = ZaberParser(), encode(ZaberMessage(1, 60, 1000))

    assert parser.feed(frame[:3], 0.0) == []
    assert parser.feed(frame[3:], 0.0105) == []
    assert parser.feed(frame, 0.0300) == [ZaberMessage(1, 60, 1000)]
    assert (parser.dropped.count, parser.resyncs) == (6, 2)


def test_long_interval_between_reads_is_not_taken_for_a_silence():
    parser, frame = ZaberParser(), encode(ZaberMessage(1, 60, 1000))
    parser.feed(frame[:3], 0.0)

    assert parser.feed(frame[3:], 0.5, since=0.002) == [ZaberMessage(1, 60, 1000)]


@given(st.binary(max_size=20).filter(lambda noise: 1 not in noise))
def test_next_valid_message_is_found_without_a_silence(noise):
    parser = ZaberParser(lambda message: message.device == 1 and message.command == 60)
    frame = encode(ZaberMessage(1, 60, 70_000))

    assert parser.feed(noise + frame, 0.0) == [ZaberMessage(1, 60, 70_000)]
    assert parser.dropped.count == len(noise)


def test_lost_byte_affects_one_message_only():
    parser = ZaberParser(lambda message: message[:2] == (1, 60) and 0 <= message.data <= 3_072_000)
    frame = encode(ZaberMessage(1, 60, 70_000))

    assert parser.feed(frame[:4] + frame[5:] + frame + frame, 0.0) == [ZaberMessage(1, 60, 70_000)] * 2
    assert (parser.dropped.count, parser.resyncs) == (5, 1)


DEVICES = (1, 2, 3)
ALIASES = tuple(alias_number(index) for index in range(3))
#: Device numbers and aliases to which a unit reacts.
LISTENERS = {0, *DEVICES, *ALIASES}
RESET, HOME, RENUMBER, RESTORE = 0, 1, 2, 36
ACTING = {RESET, HOME, RENUMBER, RESTORE}
#: All speeds that the protocol allows [Zaber units].
SPEEDS = range(-32767, 32768)
SAFE_SPEEDS = {safe_speed(speed, LISTENERS - {0}) for speed in SPEEDS} - {0}


def readings(data: bytes) -> list[tuple[int, int, int]]:
    """Return shift, device and command of each shifted reading of a message and the next message's first byte."""
    return [(shift, data[shift], data[shift + 1]) for shift in range(1, 6)]


def test_shifted_polls_and_stops_are_no_commands():
    for command in (23, 54, 60):
        for device in (*DEVICES, *ALIASES, 0):
            for following in LISTENERS:
                data = encode(ZaberMessage(device, command, -1)) + bytes([following])
                assert not [r for r in readings(data) if r[1] in LISTENERS]


def test_shifted_speed_is_no_dangerous_command():
    resets = set()
    for speed in SAFE_SPEEDS:
        for device in ALIASES:
            for following in ALIASES:
                data = struct.pack("<BBi", device, 22, speed) + bytes([following])
                for shift, listener, command in readings(data):
                    if listener in LISTENERS and command in ACTING:
                        assert command == RESET
                        assert speed > 0
                        resets.add(shift)
    # Three or four bytes must have been lost since the last silence; `LineSettings.pause` excludes that, too.
    assert resets == {3, 4}


def test_speed_without_its_command_byte_is_no_dangerous_command():
    for speed in SAFE_SPEEDS:
        device, _, command, *_ = struct.pack("<BBi", ALIASES[0], 22, speed)
        assert device in LISTENERS
        assert command not in ACTING


def test_safe_speed_is_close_to_the_desired_one_with_the_same_sign():
    for speed in SPEEDS:
        safe = safe_speed(speed, LISTENERS - {0})
        assert abs(safe - speed) <= 3
        assert safe * speed >= 0
    assert safe_speed(0, LISTENERS) == 0
    assert safe_speed(675, LISTENERS) == 675


def traffic(line: LineSettings, seconds: float) -> list[tuple[float, bytes]]:
    """Return messages of a chain with random motions and stops of three axes, with their start times on the line."""
    chain = ZaberChain([Axis(d, 9102, 38, 3_072_000, a) for d, a in zip(DEVICES, ALIASES, strict=True)], line)
    chain.polling = True
    chooser, now, free, sent = random.Random(5), 0.0, 0.0, []
    while now < seconds:
        chain.feed(b"", now)
        for axis in range(3):
            chain.command(axis, round(chooser.choice((1.0, 30.0, 3000.0)) * chooser.uniform(-3.0, 3.0)))
        if chooser.random() < 0.002:
            chain.stop()
        if data := chain.due(now):
            free = max(free, now)
            sent.append((free, data))
            free += 6 * BYTE_TIME_S
        chain.axes.lost.clear()  # no unit replies here, so the chain would count its axes as lost
        now += 0.002
    return sent


def streams(sent: list[tuple[float, bytes]]) -> list[bytes]:
    """Return the byte streams between silences that are long enough for units to find the frame again."""
    found = [sent[0][1]]
    for (before, _), (time, data) in pairwise(sent):
        if time - before - 6 * BYTE_TIME_S > RESYNC_GAP_S:
            found.append(b"")
        found[-1] += data
    return found


def shifted(stream: bytes) -> list[ZaberMessage]:
    """Return every message that a unit can read from the stream with a wrong frame."""
    frames = [stream[at : at + 6] for at in range(len(stream) - 5) if at % 6]
    return [message for message in map(decode, frames) if message.device in LISTENERS]


def test_no_shifted_reading_is_dangerous_with_a_pause_after_forward_speeds():
    sent = traffic(LineSettings(pause=1.25 * RESYNC_GAP_S), 30.0)

    assert sum(decode(data).command == 22 and decode(data).data > 0 for _, data in sent) > 250
    assert not [m for stream in streams(sent) for m in shifted(stream) if m.command in ACTING]


def test_worst_shifted_reading_without_a_pause_is_a_reset():
    sent = traffic(LineSettings(), 30.0)

    acting = {m.command for stream in streams(sent) for m in shifted(stream) if m.command in ACTING}
    assert acting == {RESET}


@pytest.mark.parametrize(
    "query", [Request(0, 53, 40, 40), Request(1, 44, 3_072_000), Request(2, 1), Request(0, 45, 1_536_000)]
)
def test_silence_follows_a_query_or_setting(query):
    chain = ZaberChain([Axis(d, 9102, 38, 3_072_000) for d in DEVICES])
    chain.send_request(query)
    sent = []
    for tick in range(50):
        if data := chain.due(tick * 0.002):
            sent.append(tick * 0.002)
            assert decode(data).command in (query.command, 22)
        chain.command(1, 500 + tick % 5 * 5)

    assert sent[1] - sent[0] - 6 * BYTE_TIME_S > RESYNC_GAP_S
