"""Faults of a simulated chain of Zaber stages have the documented effects."""

import pytest

from station.devices.zaber.protocol import ZaberMessage
from station.lab.simulated_zaber import Faults, SimulatedChain
from station.lab.zaber_unit import Unit
from tests.harness.zaber_wire import LINEAR, ROTARY, SPEED, Wire


@pytest.fixture
def wire() -> Wire:
    """Return a chain of two rotary units and a linear unit, homed and at position 100000 [microsteps]."""
    units = [Unit(ROTARY, 1, 1e5, 1e5), Unit(ROTARY, 2, 1e5, 1e5), Unit(LINEAR, 3, 1e5, 1e5)]
    return Wire(SimulatedChain(units))


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
        assert wire.chain.true_positions[2] == 100_000
        wire.chain.faults = Faults()
        wire.request(3, 21, -1000, seconds=2.0)
        assert wire.chain.true_positions[2] == 99_000  # the unit's count stays wrong until the unit is homed

    def test_stalled_zaber_motor_does_not_find_home(self, wire):
        wire.chain.faults = Faults(stalled=frozenset({3}))
        assert wire.request(3, 1, seconds=30.0) == [ZaberMessage(3, 255, 1)]

    def test_zaber_motor_loses_steps_at_a_hard_stop(self):
        unit = Unit(LINEAR, 1, true_position=600_000.0, count=0.0)  # homing has set a wrong count
        wire = Wire(SimulatedChain([unit]))
        wire.request(1, 20, 50_000, seconds=10.0)
        assert unit.position == 50_000
        assert unit.true_position == pytest.approx(604_724 + 2000)

    def test_power_cycled_zaber_unit_has_lost_its_position(self, wire):
        wire.chain.power_cycle(3)
        wire.wait(0.6)
        assert wire.request(3, 60) == [ZaberMessage(3, 60, 0)]
        assert wire.chain.true_positions[2] == 100_000

    def test_chain_damages_the_same_bytes_for_the_same_seed(self):
        def received(seed: int) -> list[ZaberMessage]:
            wire = Wire(SimulatedChain([Unit(ROTARY, 1)], seed))
            wire.chain.faults = Faults(drop=0.05, flip=0.05)
            for k in range(50):
                wire.request(1, 55, k, seconds=0.02)
            return [message for _, message in wire.received]

        assert received(4) == received(4)
        assert received(4) != received(5)
