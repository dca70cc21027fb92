"""The host's side of a chain: schedule of messages, deadlines, plausibility of positions."""

import math

import pytest

from station.devices.kernel.line import AxisLost
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.protocol import (
    MESSAGE_TIME_S,
    Reply,
    Request,
    ResetDone,
    UnexpectedMotion,
    UnsolicitedError,
    ZaberMessage,
)
from tests.harness.zaber_host import AXES, TICK, Host, changing


@pytest.fixture
def host() -> Host:
    host = Host()
    host.run(0.3)
    assert all(estimate.known for estimate in host.chain.axes.estimates)
    host.sent.clear()
    return host


def test_at_most_one_message_is_sent_every_6_25_ms(host):
    host.run(4.0, changing(host))

    times = [time for time, _ in host.sent]
    assert len(times) == pytest.approx(4.0 * 160, abs=2)  # the line's maximum of 160 messages per second
    for window in (1, 10, 100):
        # Messages never come faster than the line transmits them, except that a message may be written one tick early.
        assert min(b - a for a, b in zip(times, times[window:], strict=False)) >= window * MESSAGE_TIME_S - TICK - 1e-9


def test_each_of_three_axes_gets_40_velocities_and_13_polls_a_second(host):
    host.run(10.0, changing(host))

    for axis in AXES:
        assert len(host.commands(axis.device, 22)) / 10 == pytest.approx(40, abs=0.3)
        assert len(host.commands(axis.device, 60)) / 10 == pytest.approx(40 / 3, abs=0.3)


def test_latest_command_is_sent_and_an_unchanged_one_is_not(host):
    given = {}

    def each(now: float) -> None:
        for axis in range(3):
            given[now, axis] = 4 + round(now / TICK) % 7
            host.chain.command(axis, given[now, axis])

    host.run(1.0, each)
    for time, message in host.sent:
        if message.command == 22:
            assert message.data == given[time, message.device - 1]

    host.run(0.1)
    host.sent.clear()
    host.run(0.1, lambda now: [host.chain.command(axis, 13) for axis in range(3)])
    assert [len(host.commands(axis.device, 22)) for axis in AXES] == [1, 1, 1]


def test_unchanged_velocity_is_repeated_after_a_while():
    host = Host(LineSettings())
    host.run(0.3)
    host.run(2.0, lambda now: [host.chain.command(axis, 0) for axis in range(3)])
    # the axis has not moved since connecting, so there is no velocity to repeat
    assert host.commands(1, 22) == host.commands(1, 23) == []

    host.chain.command(0, 0)
    host.run(0.1, lambda now: host.chain.command(0, 5))
    host.places[0] = 1_536_000
    host.run(2.0, lambda now: host.chain.command(0, 0))
    assert len(host.commands(1, 23)) >= 6  # a speed of 0 is repeated as a stop command


def test_speeds_are_clipped_to_the_axis(host):
    host.run(0.1, lambda now: host.chain.command(2, -100_000))

    assert host.chain.axes.sent == [0, 0, -4300]


def test_stop_precedes_all_messages_and_addresses_all_units(host):
    host.run(1.0, changing(host))
    host.sent.clear()
    requested = host.now
    host.chain.stop()
    host.run(0.1)

    time, message = host.sent[0]
    assert message == ZaberMessage(0, 23, -1)
    assert time - requested <= MESSAGE_TIME_S
    assert [m for _, m in host.sent[1:4]] == [ZaberMessage(1, 23, -1), ZaberMessage(2, 23, -1), ZaberMessage(3, 23, -1)]
    assert host.chain.axes.sent == [0, 0, 0]
    assert not host.commands(1, 22)
    # Units that have lost the frame need more than 10 ms of silence to find it.
    assert host.sent[4][0] - host.sent[3][0] > MESSAGE_TIME_S + 0.010
    host.run(0.2)
    assert host.chain.axes.stopping == {}


def test_stop_at_every_tick_does_not_block_the_polls(host):
    host.run(1.0, lambda now: host.chain.stop())

    assert len(host.commands(3, 23)) >= 3
    assert len(host.commands(3, 60)) + len(host.commands(3, 54)) >= 3
    assert not host.chain.axes.lost


def test_stop_applies_to_an_axis_that_was_moved_again(host):
    host.status = 22  # status 22: all axes report that they move
    host.chain.stop()
    host.run(0.2, lambda now: host.chain.command(1, 50 if now > 0.4 else 0))
    assert host.chain.axes.sent[1] == 50
    host.sent.clear()

    host.chain.stop()
    host.run(0.05)
    assert host.commands(0, 23)
    assert host.chain.axes.sent[1] == 0


def test_unit_that_continues_homing_is_stopped_again_and_then_reset(host):
    host.status = 1
    host.chain.stop()
    host.run(0.5)

    assert host.commands(1, 23)[1:], "the stop was not repeated"
    resets = [message for _, message in host.sent if message.command == 0]
    assert {message.device for message in resets} == {1, 2, 3}
    assert {happening.axis for happening in host.happened if isinstance(happening, ResetDone)} == {0, 1, 2}
    first = next(time for time, message in host.sent if message == ZaberMessage(1, 0, -1))
    assert sum(time < first for time in host.commands(1, 23)) == 3


def test_axis_is_lost_after_two_missed_replies_in_a_row(host):
    host.silent = {2}
    start = host.now
    while not any(isinstance(happening, AxisLost) for happening in host.happened):
        host.run(TICK)
        assert host.now - start < 1.0
    assert host.happened == [AxisLost(1, "2 replies of a unit are missing")]
    assert host.chain.axes.counts[1].missed == 2
    assert host.now - start < 0.25
    host.run(1.0)
    assert host.happened == [AxisLost(1, "2 replies of a unit are missing")]  # reported once


def test_single_missed_reply_is_only_counted(host):
    host.silent = {2}
    while host.chain.axes.counts[1].missed == 0:
        host.run(TICK)
    host.silent = set()
    host.run(1.0)

    assert host.happened == []
    assert host.chain.axes.counts[1].missed == 1


def test_line_pauses_for_more_than_10_ms_after_a_missed_reply(host):
    host.silent = {2}
    while host.chain.axes.counts[1].missed == 0:
        host.run(TICK)
    missed = host.now
    host.silent = set()
    host.run(0.1)

    before = max(time for time, _ in host.sent if time < missed - TICK / 2)
    after = min(time for time, _ in host.sent if time > before)
    assert after - (before + MESSAGE_TIME_S) > 0.010


def test_implausible_reading_is_accepted_after_two_more(host):
    host.places[0] += 5000
    seen = [host.chain.axes.estimates[0].position]
    while host.chain.axes.estimates[0].position == 1_536_000:
        host.run(TICK)
        seen.append(host.chain.axes.estimates[0].position)

    assert host.chain.axes.counts[0].rejected == 2
    assert host.chain.axes.estimates[0].position == 1_541_000


def test_axis_that_moves_unexpectedly_is_reported(host):
    def drift(now: float) -> None:
        host.places[2] += 100

    host.run(2.0, drift)

    assert {happening.axis for happening in host.happened if isinstance(happening, UnexpectedMotion)} == {2}
    assert not any(isinstance(happening, AxisLost) for happening in host.happened)


@pytest.mark.parametrize(
    "frame",
    [
        "07 3c 00 00 10 00",  # there is no unit 7
        "01 3c ff ff ff 7f",  # the position is impossible
        "01 ff 0c 7b 00 00",  # the error number does not exist
        "01 ff 40 00 00 00",  # a valid error message, which has no position
        "ff ff ff ff ff ff",
    ],
)
def test_impossible_position_is_rejected(frame):
    host = Host()
    host.run(0.3)
    before = [estimate.position for estimate in host.chain.axes.estimates]
    happened = host.chain.feed(bytes.fromhex(frame), host.now)

    assert [estimate.position for estimate in host.chain.axes.estimates] == before
    assert all(isinstance(happening, UnsolicitedError) for happening in happened)


def test_chain_returns_the_reply_to_the_pending_request(host):
    host.chain.send_request(Request(2, 50, 0, 50))
    host.run(0.03)
    assert host.commands(3, 50)
    assert host.chain.feed(bytes.fromhex("03 32 ec 10 00 00"), host.now) == [Reply(4332)]

    host.chain.send_request(Request(0, 53, 101, 101))
    host.run(0.03)
    assert host.chain.feed(bytes.fromhex("01 ff 35 00 00 00"), host.now) == [Reply(error=53)]

    host.chain.send_request(Request(0, 63, 0, 63))
    host.run(0.2)
    assert host.happened == [Reply()]  # an empty reply: the unit has not answered in time


def test_reply_to_a_cancelled_request_is_ignored(host):
    host.chain.send_request(Request(2, 50, 0, 50))
    host.run(0.03)
    host.chain.cancel()

    assert host.chain.feed(bytes.fromhex("03 32 ec 10 00 00"), host.now) == []


def test_position_is_unknown_until_two_readings_agree():
    host = Host()
    assert math.isnan(host.chain.axes.estimates[0].position)
    host.run(0.02)
    assert not host.chain.axes.estimates[0].known
