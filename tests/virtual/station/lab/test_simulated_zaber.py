"""Faults of a simulated chain of Zaber stages have the documented effects."""

import pytest

from station.devices.zaber.protocol import BYTE_TIME_S, MESSAGE_TIME_S, ZaberMessage, encode, with_id
from station.lab.motor import quickest_motion
from station.lab.simulated_line import Faults
from station.lab.simulated_zaber import RENUMBER_TIME_S, Unit, UnitKind, simulated_chain
from station.lab.wires import BUFFER_BYTES
from tests.fuzz.zaber import fuzz
from tests.harness.zaber_wire import LINEAR, RAMP, ROTARY, SPEED, Wire


@pytest.fixture
def wire() -> Wire:
    """Return a chain of two rotary units and a linear unit, homed and at position 100000 [microsteps]."""
    units = [Unit(ROTARY, 1, 1e5, 1e5), Unit(ROTARY, 2, 1e5, 1e5), Unit(LINEAR, 3, 1e5, 1e5)]
    return Wire(simulated_chain(units))


def test_documented_exchanges_of_the_zaber_manual():
    units = [Unit(UnitKind(4421, 1000, serial=1001), 1), Unit(UnitKind(4421, 1000), 2), Unit(UnitKind(4332, 1000), 3)]
    wire = Wire(simulated_chain(units))

    assert wire.talk("00 32 00 00 00 00") == ["01 32 45 11 00 00", "02 32 45 11 00 00", "03 32 ec 10 00 00"]
    assert wire.talk("01 35 65 00 00 00") == ["01 ff 35 00 00 00"]  # error 53: the setting 101 is unknown
    assert wire.talk("01 3f 00 00 00 00") == ["01 3f e9 03 00 00"]  # serial number
    assert wire.talk("02 3f 00 00 00 00") == ["02 ff 40 00 00 00"]  # error 64: an old unit has no serial number
    assert wire.talk("01 33 00 00 00 00") == ["01 33 0b 02 00 00"]  # firmware 5.23
    assert wire.talk("01 35 25 00 00 00") == ["01 25 40 00 00 00"]  # the reply carries the setting's number
    assert wire.talk("01 35 42 00 00 00") == ["01 ff 35 00 00 00"]  # error 53: the unit has no peripheral ID
    assert wire.talk("04 32 00 00 00 00") == []  # no unit answers


def test_bytes_on_the_zaber_line_arrive_one_at_a_time(wire):
    wire.send(1, 60)
    wire.chain.advance(MESSAGE_TIME_S)
    lengths = [len(wire.chain.advance(MESSAGE_TIME_S + k * BYTE_TIME_S + 1e-5)) for k in range(1, 7)]

    assert lengths == [1, 1, 1, 1, 1, 1]


def test_partial_zaber_message_is_dropped_after_10_ms(wire):
    wire.chain.receive(encode(ZaberMessage(1, 55, 5))[:4], wire.now)
    wire.wait(0.020)
    assert [m.data for m in wire.request(1, 55, 6)] == [6]


def test_lost_byte_shifts_all_later_zaber_messages_without_a_pause(wire):
    stream = encode(ZaberMessage(1, 55, 5))[1:] + encode(ZaberMessage(1, 55, 6)) * 4
    wire.chain.receive(stream, wire.now)

    assert wire.wait(0.1) == []


def test_bytes_beyond_the_zaber_port_buffer_are_lost(wire):
    for k in range(3000):
        wire.send(1, 55, k)
    received = wire.wait(BUFFER_BYTES * BYTE_TIME_S + 1.0)

    assert [message.data for message in received] == list(range(BUFFER_BYTES // 6))
    assert [m.data for m in wire.request(1, 55, 7)] == [7]  # the unit works as before


def test_backlog_of_zaber_replies_to_broadcasts_is_bounded(wire):
    for _ in range(6):  # 6 s of queries to all three; three replies take three times as long as a query
        for _ in range(160):
            wire.send(0, 60)
        wire.wait(1.0)
    wire.received.clear()
    wire.wait(BUFFER_BYTES * BYTE_TIME_S * 2 + 0.1, tick=1e-2)
    assert wire.wait(1.0) == []


def test_zaber_command_22_is_answered_at_once_and_command_20_at_the_end_of_the_move(wire):
    assert wire.request(1, 22, 1000, seconds=0.014) == [ZaberMessage(1, 22, 1000)]
    assert wire.request(2, 20, 150_000, seconds=0.5) == []
    wire.wait(3.0)
    assert wire.received[-1][1] == ZaberMessage(2, 20, 150_000)
    # The unit moves by 50000 microsteps, with a speed of 2922 units and an acceleration of 111 units.
    top, ramp = 2922 * SPEED, 111 * RAMP
    assert wire.received[-1][0] == pytest.approx(0.014 + 2 * MESSAGE_TIME_S + 50_000 / top + top / ramp, abs=2e-3)


def test_zaber_stop_brakes_with_the_acceleration_and_replies_with_the_position(wire):
    wire.request(1, 43, 38)
    wire.request(1, 22, 9102, seconds=1.0)
    unit = wire.chain.units[0]
    wire.send(1, 23)
    wire.wait(MESSAGE_TIME_S, tick=MESSAGE_TIME_S)
    start = unit.position
    received = wire.wait(1.0)

    assert [message.command for message in received] == [23]
    assert received[0].data == round(unit.position)
    # A speed of 9102 units (20 deg/s) is braked with 100 deg/s^2 within 0.2 s and 2 deg.
    assert unit.position - start == pytest.approx((9102 * SPEED) ** 2 / (2 * 38 * RAMP), rel=1e-3)
    assert wire.request(1, 54) == [ZaberMessage(1, 54, 0)]


@pytest.mark.parametrize(("command", "status"), [((22, 500), 22), ((20, 600_000), 20), ((21, 1000), 21), ((1, 0), 1)])
def test_zaber_status_reports_the_present_motion(wire, command, status):
    wire.request(3, 42, 300)
    wire.request(3, *command)

    assert wire.request(3, 54)[-1] == ZaberMessage(3, 54, status)


@pytest.mark.parametrize(("speed", "end"), [(3000, 604_724), (-3000, 0)])
def test_zaber_motion_at_constant_speed_ends_at_the_limit_with_a_message(wire, speed, end):
    received = wire.request(3, 22, speed, seconds=25.0)

    assert received == [ZaberMessage(3, 22, speed), ZaberMessage(3, 9, end)]
    assert wire.chain.units[2].position == end
    assert wire.request(3, 22, speed, seconds=0.1)[-1] == ZaberMessage(3, 9, end)


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
        (16, 5, 64),
        (200, 0, 64),
        (36, 5, 36),
        (2, 255, 2),
    ],
)
def test_zaber_errors_have_the_numbers_of_the_manual(wire, command, data, code):
    assert wire.request(3, command, data) == [ZaberMessage(3, 255, code)]


def test_zaber_homing_finds_the_sensor_and_replies_at_the_end():
    unit = Unit(LINEAR, 1, true_position=300_000.0)  # after power-up the unit does not know its position
    wire = Wire(simulated_chain([unit]))
    assert wire.request(1, 60) == [ZaberMessage(1, 60, 0)]
    wire.request(1, 41, 5000)
    wire.send(1, 1)

    assert wire.wait(1.0) == []
    assert wire.wait(10.0) == [ZaberMessage(1, 1, 0)]
    assert unit.true_position == pytest.approx(0.0, abs=1e-6)
    assert wire.request(1, 53, 40)[0].data & 1 << 7


@pytest.mark.parametrize("command", [1, 20, 21, 22, 23])
def test_zaber_unit_is_busy_while_it_homes(wire, command):
    wire.request(3, 1)
    assert wire.request(3, command) == [ZaberMessage(3, 255, 255)]
    assert wire.request(3, 54) == [ZaberMessage(3, 54, 1)]


def test_zaber_reset_stops_homing_and_loses_the_position_without_a_reply(wire):
    wire.request(3, 1, seconds=0.5)
    place = wire.chain.units[2].true_position
    assert wire.request(3, 0, seconds=0.6) == []

    assert wire.request(3, 54) == [ZaberMessage(3, 54, 0)]
    assert wire.request(3, 60) == [ZaberMessage(3, 60, 0)]
    assert not wire.request(3, 53, 40)[0].data & 1 << 7
    assert 0 < place - wire.chain.units[2].true_position < 30_000 * (MESSAGE_TIME_S + 1e-3)


def test_zaber_unit_without_automatic_replies_answers_only_queries(wire):
    wire.request(3, 40, 1)
    for command, data in ((22, 100), (23, 0), (21, 10), (43, 50), (1, 0), (45, 77), (22, 99_999)):
        assert wire.request(3, command, data, seconds=0.3) == []
    assert wire.request(3, 60)[0].command == 60
    assert wire.request(3, 53, 43) == [ZaberMessage(3, 43, 50)]
    assert wire.request(3, 55, -5) == [ZaberMessage(3, 55, -5)]
    assert wire.request(3, 53, 200) == [ZaberMessage(3, 255, 53)]


def test_each_write_of_the_zaber_mode_replaces_all_bits_and_the_homed_flag(wire):
    assert wire.request(3, 53, 40)[0].data & 1 << 7
    wire.request(3, 40, 1 << 3)
    assert wire.request(3, 53, 40) == [ZaberMessage(3, 40, 1 << 3)]
    wire.request(3, 45, 1000)
    assert wire.request(3, 53, 40) == [ZaberMessage(3, 40, 1 << 3 | 1 << 7)]


def test_zaber_message_ids_are_echoed_and_a_move_keeps_its_id(wire):
    wire.request(3, 40, 1 << 6)
    assert wire.request(3, 60, with_id(0, 1)) == [ZaberMessage(3, 60, with_id(100_000, 1))]
    wire.send(3, 21, with_id(-2000, 7))
    wire.request(3, 54, with_id(0, 8), seconds=0.03)
    received = wire.wait(2.0)

    assert wire.received[-2][1] == ZaberMessage(3, 54, with_id(21, 8))
    assert received == [ZaberMessage(3, 21, with_id(98_000, 7))]


def test_zaber_units_ignore_commands_for_half_a_second_after_renumbering():
    wire = Wire(simulated_chain([Unit(ROTARY, 9), Unit(LINEAR, 9)]))
    wire.send(0, 2)
    wire.wait(0.02)
    assert wire.received[0][1] == ZaberMessage(1, 2, 4421)
    wire.wait(0.01)
    assert wire.received[1][1] == ZaberMessage(2, 2, 4332)
    assert wire.request(1, 60) == []
    wire.wait(RENUMBER_TIME_S)
    assert [m.device for m in wire.request(0, 60)] == [1, 2]
    assert wire.request(2, 2, 77) == [ZaberMessage(77, 2, 4332)]
    assert wire.request(77, 60) == [ZaberMessage(77, 60, 0)]


def test_locked_zaber_unit_keeps_its_settings(wire):
    wire.request(3, 49, 1)
    assert wire.request(3, 43, 5) == [ZaberMessage(3, 255, 3600)]


@pytest.mark.parametrize(
    ("start", "velocity", "goal"), [(0, 0, 1e6), (0, 0, 10), (0, 5e4, 1e3), (0, -5e4, 1e3), (5, 9e4, -3e5), (3, 0, 3)]
)
def test_zaber_motion_ends_at_rest_at_its_goal_within_the_speed_limit(start, velocity, goal):
    top, ramp = 6e4, 4e5
    position, speed, fastest = float(start), float(velocity), 0.0
    for segment in quickest_motion(position, speed, goal, top, ramp):
        assert segment.duration >= 0.0
        assert abs(segment.acceleration) in (0.0, ramp)
        position += (speed + 0.5 * segment.acceleration * segment.duration) * segment.duration
        speed += segment.acceleration * segment.duration
        fastest = max(fastest, abs(speed))

    assert position == pytest.approx(goal, abs=1e-6)
    assert speed == pytest.approx(0.0, abs=1e-6)
    assert fastest <= max(top, abs(velocity)) + 1e-6


class TestFaults:
    """Faults of a chain."""

    def test_chain_loses_bytes_and_flips_bits_at_the_configured_rate(self, wire):
        wire.chain.faults = Faults(drop=0.02)
        for k in range(200):
            wire.request(1, 55, k, seconds=0.03)
        answered = sum(message.command == 55 for _, message in wire.received)
        assert pytest.approx(answered, abs=30) == 200 * (1 - 0.02) ** 12

    def test_mute_zaber_unit_moves_without_replies(self, wire):
        wire.chain.faults = Faults(mute=frozenset({2}))
        assert wire.request(2, 22, 1000, seconds=0.5) == []
        assert wire.chain.units[1].position > 100_000
        assert wire.request(1, 55, 1) == [ZaberMessage(1, 55, 1)]

    def test_zaber_units_behind_a_cut_cable_receive_nothing_and_keep_moving(self, wire):
        wire.request(3, 22, 1000)
        wire.chain.faults = Faults(cut=2)
        assert wire.request(0, 23, seconds=30.0) == [ZaberMessage(1, 23, 100_000)]
        # No device supervises the unit behind the cut, so it continues to move, here for 30 s.
        assert wire.chain.units[2].position == pytest.approx(100_000 + 1000 * SPEED * 30, rel=0.01)
        wire.chain.faults = Faults(cut=1)
        assert wire.request(1, 55) == []
        wire.chain.faults = Faults()
        assert wire.request(3, 55) == [ZaberMessage(3, 55, 0)]

    def test_delay_fault_delays_every_reply_of_the_chain(self, wire):
        wire.chain.faults = Faults(delay=0.1)
        assert wire.request(1, 55, seconds=0.1) == []
        assert wire.wait(0.02) == [ZaberMessage(1, 55, 0)]

    def test_stalled_zaber_motor_counts_steps_without_moving(self, wire):
        wire.chain.faults = Faults(stalled=frozenset({3}))
        assert wire.request(3, 21, 5000, seconds=2.0) == [ZaberMessage(3, 21, 105_000)]
        assert wire.chain.units[2].true_position == 100_000
        wire.chain.faults = Faults()
        wire.request(3, 21, -1000, seconds=2.0)
        assert wire.chain.units[2].true_position == 99_000  # the unit's count stays wrong until the unit is homed

    def test_stalled_zaber_motor_does_not_find_home(self, wire):
        wire.chain.faults = Faults(stalled=frozenset({3}))
        assert wire.request(3, 1, seconds=30.0) == [ZaberMessage(3, 255, 1)]

    def test_zaber_motor_loses_steps_at_a_hard_stop(self):
        unit = Unit(LINEAR, 1, true_position=600_000.0, count=0.0)  # homing has set a wrong count
        wire = Wire(simulated_chain([unit]))
        wire.request(1, 20, 50_000, seconds=10.0)
        assert unit.position == 50_000
        assert unit.true_position == pytest.approx(604_724 + 2000)

    def test_power_cycled_zaber_unit_has_lost_its_position(self, wire):
        wire.chain.power_cycle(3)
        wire.wait(0.6)
        assert wire.request(3, 60) == [ZaberMessage(3, 60, 0)]
        assert wire.chain.units[2].true_position == 100_000


def test_units_survive_random_bytes():
    assert fuzz(1_000, seed=6) == {"cases": 1_000, "exceptions": 0, "hangs": 0, "false_accepts": 0}
