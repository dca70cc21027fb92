"""A row that the controller does not renew says so."""

import pytest

from station.control.states import State
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture
def virtual() -> VirtualStation:
    return VirtualStation(usual_case())


def held(virtual: VirtualStation) -> bool:
    return bool(virtual.loop.channels.of(virtual.rows[-1], "held")[0])


def test_a_row_is_held_while_the_stages_are_homed_and_no_longer(virtual: VirtualStation) -> None:
    virtual.becomes(State.READY)
    virtual.tick(10)
    assert not held(virtual)
    virtual.loop.home(virtual.now)
    virtual.tick()
    assert held(virtual)
    virtual.becomes(State.READY, 120.0)
    virtual.tick(10)
    assert not held(virtual)


def test_a_row_is_held_in_a_fault_that_loses_the_stages_and_not_in_another(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.loop.stop(virtual.now, cause="a person")
    virtual.tick(10)
    assert not held(virtual)  # robot, tracker and sensors are looked at as ever
    virtual.fail("mute", "stages")
    virtual.becomes(State.FAULT)
    virtual.tick(10)
    assert held(virtual)
