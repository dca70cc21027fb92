"""Simulated Zaber units: every rule of the manual that a client can notice, byte by byte in virtual time."""

from itertools import pairwise

import pytest

from station.devices.links.memory_pipe import memory_pipe
from station.devices.zaber.protocol import BYTE_TIME, MESSAGE_TIME, Message, decode, encode, with_id
from station.lab.zaber.motion import way
from station.lab.zaber.simulated import BUFFER, RENUMBERING, SimulatedChain, pump
from station.lab.zaber.unit import Unit, UnitKind
from tests.harness.real_lines import pty_line, socket_line
from tests.harness.zaber_wire import LINEAR, RAMP, ROTARY, SPEED, Wire


@pytest.fixture
def wire() -> Wire:
    """Two rotary units and a linear one, homed, at 100000."""
    units = [Unit(ROTARY, 1, 1e5, 1e5), Unit(ROTARY, 2, 1e5, 1e5), Unit(LINEAR, 3, 1e5, 1e5)]
    return Wire(SimulatedChain(units))


def test_the_exchanges_of_the_manual():
    units = [Unit(UnitKind(4421, 1000, serial=1001), 1), Unit(UnitKind(4421, 1000), 2), Unit(UnitKind(4332, 1000), 3)]
    wire = Wire(SimulatedChain(units))

    assert wire.talk("00 32 00 00 00 00") == ["01 32 45 11 00 00", "02 32 45 11 00 00", "03 32 ec 10 00 00"]
    assert wire.talk("01 35 65 00 00 00") == ["01 ff 35 00 00 00"]  # setting 101 unknown
    assert wire.talk("01 3f 00 00 00 00") == ["01 3f e9 03 00 00"]  # serial number
    assert wire.talk("02 3f 00 00 00 00") == ["02 ff 40 00 00 00"]  # an old unit has none: error 64
    assert wire.talk("01 33 00 00 00 00") == ["01 33 0b 02 00 00"]  # firmware 5.23
    assert wire.talk("01 35 25 00 00 00") == ["01 25 40 00 00 00"]  # the reply carries the setting's number
    assert wire.talk("01 35 42 00 00 00") == ["01 ff 35 00 00 00"]  # peripheral ID: none
    assert wire.talk("04 32 00 00 00 00") == []  # nobody


def test_an_exchange_takes_twice_the_time_of_a_message(wire):
    wire.send(3, 55, 77)

    assert wire.wait(2 * MESSAGE_TIME - 2e-4, tick=1e-4) == []
    assert wire.wait(4e-4, tick=1e-4) == [Message(3, 55, 77)]


def test_the_line_carries_160_messages_a_second_each_way(wire):
    for k in range(320):
        wire.send(1, 55, k)
    heard = wire.wait(2.0 + MESSAGE_TIME + 1e-3)

    assert len(heard) == 320
    assert [message.data for message in heard] == list(range(320))
    early = [time for time, _ in wire.heard if time <= 1.0015]
    assert len(early) == 159  # the first second lacks the first message's way to the unit


def test_bytes_come_one_at_a_time(wire):
    wire.send(1, 60)
    wire.chain.advance(MESSAGE_TIME)
    lengths = [len(wire.chain.advance(MESSAGE_TIME + k * BYTE_TIME + 1e-5)) for k in range(1, 7)]

    assert lengths == [1, 1, 1, 1, 1, 1]


def test_a_partial_message_is_dropped_after_10_ms(wire):
    wire.chain.receive(encode(Message(1, 55, 5))[:4], wire.now)
    wire.wait(0.020)
    assert [m.data for m in wire.ask(1, 55, 6)] == [6]


def test_without_a_silence_a_lost_byte_shifts_everything_after_it(wire):
    stream = encode(Message(1, 55, 5))[1:] + encode(Message(1, 55, 6)) * 4
    wire.chain.receive(stream, wire.now)

    assert wire.wait(0.1) == []


def test_a_flood_fills_the_port_and_the_rest_is_lost(wire):
    for k in range(3000):
        wire.send(1, 55, k)
    heard = wire.wait(BUFFER * BYTE_TIME + 1.0)

    assert [message.data for message in heard] == list(range(BUFFER // 6))
    assert [m.data for m in wire.ask(1, 55, 7)] == [7]  # and it is as good as before


def test_replies_to_all_do_not_pile_up_without_end(wire):
    for _ in range(60):  # 60 s of questions to all three, answered three times as slowly as they can be asked
        for _ in range(160):
            wire.send(0, 60)
        wire.wait(1.0)
    wire.heard.clear()
    wire.wait(BUFFER * BYTE_TIME * 2 + 0.1, tick=1e-2)
    assert wire.wait(1.0) == []


def test_22_is_answered_at_once_and_20_when_the_move_ends(wire):
    assert wire.ask(1, 22, 1000, seconds=0.014) == [Message(1, 22, 1000)]
    assert wire.ask(2, 20, 150_000, seconds=0.5) == []
    wire.wait(3.0)
    assert wire.heard[-1][1] == Message(2, 20, 150_000)
    # 50000 microsteps at 2922 units with ramps of 111 units.
    top, ramp = 2922 * SPEED, 111 * RAMP
    assert wire.heard[-1][0] == pytest.approx(0.014 + 2 * MESSAGE_TIME + 50_000 / top + top / ramp, abs=2e-3)


def test_a_move_that_is_pre_empted_never_answers(wire):
    wire.send(1, 20, 500_000)
    wire.wait(0.2)
    wire.send(1, 21, -1000)
    heard = wire.wait(5.0)

    assert [message.command for message in heard] == [21]
    where = wire.chain.units[0].position
    assert heard[0].data == where


def test_a_stop_brakes_with_the_acceleration_and_answers_where(wire):
    wire.ask(1, 43, 38)
    wire.ask(1, 22, 9102, seconds=1.0)
    unit = wire.chain.units[0]
    wire.send(1, 23)
    wire.wait(MESSAGE_TIME, tick=MESSAGE_TIME)
    begin = unit.position
    heard = wire.wait(1.0)

    assert [message.command for message in heard] == [23]
    assert heard[0].data == round(unit.position)
    # 9102 units, 20 deg/s, are braked at 100 deg/s^2 within 0.2 s and 2 deg.
    assert unit.position - begin == pytest.approx((9102 * SPEED) ** 2 / (2 * 38 * RAMP), rel=1e-3)
    assert wire.ask(1, 54) == [Message(1, 54, 0)]


@pytest.mark.parametrize(
    ("command", "status"), [((22, 500), 22), ((20, 600_000), 20), ((21, 1000), 21), ((1, 0), 1), ((18, 3), 18)]
)
def test_the_status_tells_what_it_does(wire, command, status):
    wire.ask(3, 20, 400_000, seconds=20.0)
    wire.ask(3, 16, 3)
    wire.ask(3, 20, 100_000, seconds=20.0)
    wire.ask(3, 42, 300)
    wire.ask(3, *command)

    assert wire.ask(3, 54)[-1] == Message(3, 54, status)


@pytest.mark.parametrize(("speed", "end"), [(3000, 604_724), (-3000, 0)])
def test_a_constant_speed_ends_at_the_limit_and_says_so(wire, speed, end):
    heard = wire.ask(3, 22, speed, seconds=25.0)

    assert heard == [Message(3, 22, speed), Message(3, 9, end)]
    assert wire.chain.units[2].position == end
    assert wire.ask(3, 22, speed, seconds=0.1)[-1] == Message(3, 9, end)


def test_speed_zero_ends_a_motion_as_a_limit_does(wire):
    wire.ask(3, 22, 1000, seconds=0.5)
    heard = wire.ask(3, 22, 0, seconds=0.5)

    assert heard == [Message(3, 22, 0), Message(3, 9, round(wire.chain.units[2].position))]


@pytest.mark.parametrize(
    ("command", "data", "code"),
    [
        (20, -1, 20),
        (20, 604_725, 20),
        (21, 504_725, 21),
        (22, 32_768, 22),
        (22, -32_768, 22),
        (37, 65, 37),
        (40, 1 << 16, 40),
        (40, 1 << 10, 4010),
        (41, 32_768, 41),
        (42, -1, 42),
        (43, 32_768, 43),
        (44, 16_777_216, 44),
        (45, -1, 45),
        (48, 255, 48),
        (53, 200, 53),
        (17, 16, 1700),
        (200, 0, 64),
        (36, 5, 36),
        (2, 255, 2),
    ],
)
def test_errors_have_the_numbers_of_the_manual(wire, command, data, code):
    assert wire.ask(3, command, data) == [Message(3, 255, code)]


def test_speed_zero_makes_moves_fail(wire):
    wire.ask(3, 42, 0)
    assert wire.ask(3, 20, 5) == [Message(3, 255, 20)]


def test_home_finds_the_sensor_and_answers_at_the_end():
    unit = Unit(LINEAR, 1, place=300_000.0)  # just switched on: it does not know where it is
    wire = Wire(SimulatedChain([unit]))
    assert wire.ask(1, 60) == [Message(1, 60, 0)]
    wire.ask(1, 41, 5000)
    wire.send(1, 1)

    assert wire.wait(1.0) == []
    assert wire.wait(10.0) == [Message(1, 1, 0)]
    assert unit.place == pytest.approx(0.0, abs=1e-6)
    assert wire.ask(1, 53, 40)[0].data & 1 << 7


def test_a_home_offset_moves_the_zero(wire):
    wire.ask(3, 47, 5000)
    wire.ask(3, 1, seconds=30.0)

    assert wire.chain.units[2].place == pytest.approx(5000.0, abs=1e-6)
    assert wire.ask(3, 60) == [Message(3, 60, 0)]


@pytest.mark.parametrize("command", [1, 18, 20, 21, 22, 23])
def test_a_unit_that_homes_is_busy(wire, command):
    wire.ask(3, 1)
    assert wire.ask(3, command) == [Message(3, 255, 255)]
    assert wire.ask(3, 54) == [Message(3, 54, 1)]


def test_a_reset_stops_homing_loses_the_position_and_says_nothing(wire):
    wire.ask(3, 1, seconds=0.5)
    place = wire.chain.units[2].place
    assert wire.ask(3, 0, seconds=0.6) == []

    assert wire.ask(3, 54) == [Message(3, 54, 0)]
    assert wire.ask(3, 60) == [Message(3, 60, 0)]
    assert not wire.ask(3, 53, 40)[0].data & 1 << 7
    assert 0 < place - wire.chain.units[2].place < 30_000 * (MESSAGE_TIME + 1e-3)


def test_without_automatic_replies_only_questions_are_answered(wire):
    wire.ask(3, 40, 1)
    for command, data in ((22, 100), (23, 0), (21, 10), (43, 50), (1, 0), (45, 77), (22, 99_999)):
        assert wire.ask(3, command, data, seconds=0.3) == []
    assert wire.ask(3, 60)[0].command == 60
    assert wire.ask(3, 53, 43) == [Message(3, 43, 50)]
    assert wire.ask(3, 55, -5) == [Message(3, 55, -5)]
    assert wire.ask(3, 53, 200) == [Message(3, 255, 53)]


def test_each_write_of_the_mode_replaces_all_bits_and_the_homed_flag(wire):
    assert wire.ask(3, 53, 40)[0].data & 1 << 7
    wire.ask(3, 40, 1 << 3)
    assert wire.ask(3, 53, 40) == [Message(3, 40, 1 << 3)]
    wire.ask(3, 45, 1000)
    assert wire.ask(3, 53, 40) == [Message(3, 40, 1 << 3 | 1 << 7)]


def test_setting_the_position_moves_the_count_and_not_the_stage(wire):
    place = wire.chain.units[0].place
    assert wire.ask(1, 45, 1_536_000) == [Message(1, 45, 1_536_000)]
    assert wire.chain.units[0].place == place
    wire.ask(1, 44, 3_072_000)
    wire.ask(1, 21, 1000, seconds=1.0)
    assert wire.chain.units[0].place == place + 1000


def test_move_tracking_every_quarter_of_a_second(wire):
    wire.ask(3, 40, 1 << 4)
    wire.ask(3, 20, 300_000, seconds=5.0)
    times = [time for time, message in wire.heard if message.command == 8]

    assert len(times) >= 8
    assert [b - a for a, b in pairwise(times)] == pytest.approx([0.25] * (len(times) - 1), abs=2e-3)


def test_message_ids_are_echoed_and_a_move_keeps_its_own(wire):
    wire.ask(3, 40, 1 << 6)
    assert wire.ask(3, 60, with_id(0, 1)) == [Message(3, 60, with_id(100_000, 1))]
    wire.send(3, 21, with_id(-2000, 7))
    wire.ask(3, 54, with_id(0, 8), seconds=0.03)
    heard = wire.wait(2.0)

    assert wire.heard[-2][1] == Message(3, 54, with_id(21, 8))
    assert heard == [Message(3, 21, with_id(98_000, 7))]


def test_renumbering_takes_half_a_second_in_which_nothing_is_heard():
    wire = Wire(SimulatedChain([Unit(ROTARY, 9), Unit(LINEAR, 9)]))
    wire.send(0, 2)
    wire.wait(0.02)
    assert wire.heard[0][1] == Message(1, 2, 4421)
    wire.wait(0.01)
    assert wire.heard[1][1] == Message(2, 2, 4332)
    assert wire.ask(1, 60) == []
    wire.wait(RENUMBERING)
    assert [m.device for m in wire.ask(0, 60)] == [1, 2]
    assert wire.ask(2, 2, 77) == [Message(77, 2, 4332)]
    assert wire.ask(77, 60) == [Message(77, 60, 0)]


def test_the_knob_moves_a_stage_unless_it_is_disabled(wire):
    wire.chain.turn_knob(3, 500)
    assert wire.wait(0.05) == [Message(3, 10, 100_500)]
    wire.ask(3, 40, 1 << 3)
    wire.chain.turn_knob(3, 500)
    assert wire.wait(0.05) == []
    assert wire.ask(3, 60) == [Message(3, 60, 100_500)]


def test_stored_positions(wire):
    assert wire.ask(3, 16, 5) == [Message(3, 16, 5)]
    wire.ask(3, 21, 5000, seconds=2.0)
    assert wire.ask(3, 17, 5) == [Message(3, 17, 100_000)]
    assert wire.ask(3, 18, 5, seconds=2.0) == [Message(3, 18, 100_000)]


def test_a_locked_unit_keeps_its_settings(wire):
    wire.ask(3, 49, 1)
    assert wire.ask(3, 43, 5) == [Message(3, 255, 3600)]


def test_alias_and_voltage(wire):
    wire.ask(3, 48, 20)
    assert wire.ask(20, 52) == [Message(3, 52, 150)]


@pytest.mark.parametrize(
    ("begin", "velocity", "goal"), [(0, 0, 1e6), (0, 0, 10), (0, 5e4, 1e3), (0, -5e4, 1e3), (5, 9e4, -3e5), (3, 0, 3)]
)
def test_the_way_to_a_goal_ends_there_at_rest_and_keeps_to_the_speed(begin, velocity, goal):
    top, ramp = 6e4, 4e5
    position, speed, fastest = float(begin), float(velocity), 0.0
    for segment in way(position, speed, goal, top, ramp):
        assert segment.duration >= 0.0
        assert abs(segment.acceleration) in (0.0, ramp)
        position += (speed + 0.5 * segment.acceleration * segment.duration) * segment.duration
        speed += segment.acceleration * segment.duration
        fastest = max(fastest, abs(speed))

    assert position == pytest.approx(goal, abs=1e-6)
    assert speed == pytest.approx(0.0, abs=1e-6)
    assert fastest <= max(top, abs(velocity)) + 1e-6


def test_motion_does_not_depend_on_how_often_it_is_looked_at():
    def places(tick: float) -> list[float]:
        wire = Wire(SimulatedChain([Unit(LINEAR, 1, 1e5, 1e5)]))
        for speed in (500, -3000, 2000, 0):
            wire.send(1, 22, speed)
            wire.wait(0.4, tick)
        return wire.chain.places

    assert places(0.002) == pytest.approx(places(0.05), abs=1e-6)


def test_one_code_for_pipes_ptys_and_sockets():
    """The same question over three kinds of link gets the same answer."""
    host, device = memory_pipe("chain")
    assert asked(host, device) == Message(2, 50, 4332)

    for line in (pty_line, socket_line):
        with line() as (near, far):
            assert asked(near, far) == Message(2, 50, 4332)


def asked(host, device) -> Message:
    """Who is number 2?"""
    chain, now, heard = SimulatedChain([Unit(ROTARY, 1), Unit(LINEAR, 2)]), 0.0, b""
    host.write(encode(Message(2, 50, 0)))
    while len(heard) < 6:
        assert now < 1.0
        now += 0.001
        pump(device, chain, now)
        heard += host.read()
    return decode(heard)
