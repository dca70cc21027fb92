"""What units that have lost the frame could take our own messages for: every shift, every speed, every pair."""

import random
import struct
from itertools import pairwise

import pytest

from station.devices.zaber.chain import Axis, Chain, Line
from station.devices.zaber.dialogue import Ask
from station.devices.zaber.protocol import BYTE_TIME, GAP, Message, decode, encode
from station.devices.zaber.shifts import alias, sayable

DEVICES = (1, 2, 3)
ALIASES = tuple(alias(place) for place in range(3))
#: Whoever is called by one of these acts.
LISTENERS = {0, *DEVICES, *ALIASES}
RESET, HOME, RENUMBER, RESTORE = 0, 1, 2, 36
ACTING = {RESET, HOME, RENUMBER, RESTORE}
#: Everything that a speed may be in the protocol.
SPEEDS = range(-32767, 32768)


def readings(data: bytes) -> list[tuple[int, int, int]]:
    """Shift, device and command of what can be read out of a message that goes on into the next one's first byte."""
    return [(shift, data[shift], data[shift + 1]) for shift in range(1, 6)]


def test_polls_and_stops_read_as_nothing_at_any_shift():
    for command in (23, 54, 60):
        for device in (*DEVICES, *ALIASES, 0):
            for following in LISTENERS:
                data = encode(Message(device, command, -1)) + bytes([following])
                assert not [r for r in readings(data) if r[1] in LISTENERS]


def test_a_speed_never_reads_as_home_renumber_or_restore_and_backwards_not_as_a_reset_either():
    resets = set()
    for speed in {sayable(speed, LISTENERS - {0}) for speed in SPEEDS} - {0}:
        for device in ALIASES:
            for following in ALIASES:
                data = struct.pack("<BBi", device, 22, speed) + bytes([following])
                for shift, listener, command in readings(data):
                    if listener in LISTENERS and command in ACTING:
                        assert command == RESET
                        assert speed > 0
                        resets.add(shift)
    # Three or four bytes must have been lost since the last silence; `Line.pause` excludes that, too.
    assert resets == {3, 4}


def test_a_speed_without_its_command_byte_is_no_command_that_acts():
    for speed in {sayable(speed, LISTENERS - {0}) for speed in SPEEDS} - {0}:
        device, _, command, *_ = struct.pack("<BBi", ALIASES[0], 22, speed)
        assert device in LISTENERS
        assert command not in ACTING


def test_the_speed_that_is_said_is_close_to_the_one_meant_and_never_in_the_other_direction():
    for speed in SPEEDS:
        said = sayable(speed, LISTENERS - {0})
        assert abs(said - speed) <= 3
        assert said * speed >= 0
    assert sayable(0, LISTENERS) == 0
    assert sayable(675, LISTENERS) == 675


def traffic(line: Line, seconds: float) -> list[tuple[float, bytes]]:
    """Messages of a chain that moves three axes at random, with stops in between, and when each begins on the line."""
    chain = Chain([Axis(d, 9102, 38, 3_072_000, a) for d, a in zip(DEVICES, ALIASES, strict=True)], line)
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
            free += 6 * BYTE_TIME
        chain.lost.clear()  # nobody answers here
        now += 0.002
    return sent


def streams(sent: list[tuple[float, bytes]]) -> list[bytes]:
    """What comes without a silence in which units find the frame again."""
    found = [sent[0][1]]
    for (before, _), (time, data) in pairwise(sent):
        if time - before - 6 * BYTE_TIME > GAP:
            found.append(b"")
        found[-1] += data
    return found


def shifted(stream: bytes) -> list[Message]:
    """Every message that a unit can read in it with a wrong frame."""
    frames = [stream[at : at + 6] for at in range(len(stream) - 5) if at % 6]
    return [message for message in map(decode, frames) if message.device in LISTENERS]


def test_with_a_pause_after_forward_speeds_no_shifted_reading_of_the_traffic_acts():
    sent = traffic(Line(pause=1.25 * GAP), 60.0)

    assert sum(decode(data).command == 22 and decode(data).data > 0 for _, data in sent) > 500
    assert not [m for stream in streams(sent) for m in shifted(stream) if m.command in ACTING]


def test_without_it_the_traffic_can_be_read_as_a_reset_at_worst():
    sent = traffic(Line(), 60.0)

    acting = {m.command for stream in streams(sent) for m in shifted(stream) if m.command in ACTING}
    assert acting == {RESET}


@pytest.mark.parametrize("ask", [Ask(0, 53, 40, 40), Ask(1, 44, 3_072_000), Ask(2, 1), Ask(0, 45, 1_536_000)])
def test_after_a_question_or_setting_there_is_a_silence(ask):
    chain = Chain([Axis(d, 9102, 38, 3_072_000) for d in DEVICES])
    chain.ask(ask)
    sent = []
    for tick in range(50):
        if data := chain.due(tick * 0.002):
            sent.append(tick * 0.002)
            assert decode(data).command in (ask.command, 22)
        chain.command(1, 500 + tick % 5 * 5)

    assert sent[1] - sent[0] - 6 * BYTE_TIME > GAP
