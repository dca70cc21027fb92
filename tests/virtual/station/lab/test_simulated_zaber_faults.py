"""What can be wrong with a simulated chain of stages."""

import pytest

from station.devices.zaber.protocol import Message
from station.lab.zaber.simulated import Faults, SimulatedChain
from station.lab.zaber.unit import Unit
from tests.harness.zaber_wire import LINEAR, ROTARY, SPEED, Wire


@pytest.fixture
def wire() -> Wire:
    """Two rotary units and a linear one, homed, at 100000."""
    units = [Unit(ROTARY, 1, 1e5, 1e5), Unit(ROTARY, 2, 1e5, 1e5), Unit(LINEAR, 3, 1e5, 1e5)]
    return Wire(SimulatedChain(units))


class TestFaults:
    """What can be wrong with a chain."""

    def test_lost_and_turned_bits_come_as_often_as_asked_for(self, wire):
        wire.chain.faults = Faults(drop=0.02)
        for k in range(200):
            wire.ask(1, 55, k, seconds=0.03)
        answered = sum(message.command == 55 for _, message in wire.heard)
        assert pytest.approx(answered, abs=30) == 200 * (1 - 0.02) ** 12

    def test_a_mute_unit_moves_and_says_nothing(self, wire):
        wire.chain.faults = Faults(mute=frozenset({2}))
        assert wire.ask(2, 22, 1000, seconds=0.5) == []
        assert wire.chain.units[1].position > 100_000
        assert wire.ask(1, 55, 1) == [Message(1, 55, 1)]

    def test_behind_a_cut_nothing_is_heard_and_motion_goes_on(self, wire):
        wire.ask(3, 22, 1000)
        wire.chain.faults = Faults(cut=2)
        assert wire.ask(0, 23, seconds=30.0) == [Message(1, 23, 100_000)]
        # Nothing watches it: it runs on, here for 30 s.
        assert wire.chain.units[2].position == pytest.approx(100_000 + 1000 * SPEED * 30, rel=0.01)
        wire.chain.faults = Faults(cut=1)
        assert wire.ask(1, 55) == []
        wire.chain.faults = Faults()
        assert wire.ask(3, 55) == [Message(3, 55, 0)]

    def test_a_delay_holds_every_reply(self, wire):
        wire.chain.faults = Faults(delay=0.1)
        assert wire.ask(1, 55, seconds=0.1) == []
        assert wire.wait(0.02) == [Message(1, 55, 0)]

    def test_a_stalled_motor_counts_steps_that_it_does_not_make(self, wire):
        wire.chain.faults = Faults(stalled=frozenset({3}))
        assert wire.ask(3, 21, 5000, seconds=2.0) == [Message(3, 21, 105_000)]
        assert wire.chain.places[2] == 100_000
        wire.chain.faults = Faults()
        wire.ask(3, 21, -1000, seconds=2.0)
        assert wire.chain.places[2] == 99_000  # the count stays wrong until it is homed

    def test_a_stalled_motor_does_not_find_home(self, wire):
        wire.chain.faults = Faults(stalled=frozenset({3}))
        assert wire.ask(3, 1, seconds=30.0) == [Message(3, 255, 1)]

    def test_a_hard_stop_takes_steps(self):
        unit = Unit(LINEAR, 1, place=600_000.0, count=0.0)  # homed wrongly
        wire = Wire(SimulatedChain([unit]))
        wire.ask(1, 20, 50_000, seconds=10.0)
        assert unit.position == 50_000
        assert unit.place == pytest.approx(604_724 + 2000)

    def test_power_lost_and_back(self, wire):
        wire.chain.power_cycle(3)
        wire.wait(0.6)
        assert wire.ask(3, 60) == [Message(3, 60, 0)]
        assert wire.chain.places[2] == 100_000

    def test_the_same_seed_does_the_same_damage(self):
        def heard(seed: int) -> list[Message]:
            wire = Wire(SimulatedChain([Unit(ROTARY, 1)], seed))
            wire.chain.faults = Faults(drop=0.05, flip=0.05)
            for k in range(50):
                wire.ask(1, 55, k, seconds=0.02)
            return [message for _, message in wire.heard]

        assert heard(4) == heard(4)
        assert heard(4) != heard(5)
