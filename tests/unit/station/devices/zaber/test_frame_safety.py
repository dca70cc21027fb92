"""Misreadings of the host's messages by units that lost the frame: every shift, speed and pair."""

import random
import struct
from itertools import pairwise

import pytest

from station.devices.zaber.chain import Axis, LineSettings, ZaberChain
from station.devices.zaber.protocol import (
    BYTE_TIME_S,
    RESYNC_GAP_S,
    Request,
    ZaberMessage,
    alias_number,
    decode,
    encode,
    safe_speed,
)

DEVICES = (1, 2, 3)
ALIASES = tuple(alias_number(index) for index in range(3))
#: Device numbers and aliases to which a unit reacts.
LISTENERS = {0, *DEVICES, *ALIASES}
RESET, HOME, RENUMBER, RESTORE = 0, 1, 2, 36
ACTING = {RESET, HOME, RENUMBER, RESTORE}
#: All speeds that the protocol allows [Zaber units].
SPEEDS = range(-32767, 32768)


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
    for speed in {safe_speed(speed, LISTENERS - {0}) for speed in SPEEDS} - {0}:
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
    for speed in {safe_speed(speed, LISTENERS - {0}) for speed in SPEEDS} - {0}:
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
        chain.lost.clear()  # no unit replies here, so the chain would count its axes as lost
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
    sent = traffic(LineSettings(pause=1.25 * RESYNC_GAP_S), 60.0)

    assert sum(decode(data).command == 22 and decode(data).data > 0 for _, data in sent) > 500
    assert not [m for stream in streams(sent) for m in shifted(stream) if m.command in ACTING]


def test_worst_shifted_reading_without_a_pause_is_a_reset():
    sent = traffic(LineSettings(), 60.0)

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
