"""A row that the controller does not renew says so."""

import pytest

from station.control.states import State
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture
def virtual() -> VirtualStation:
    return VirtualStation(usual_case())


def test_a_row_is_held_while_the_stages_are_homed_and_no_longer(virtual: VirtualStation) -> None:
    virtual.becomes(State.READY)
    virtual.tick(10)
    assert not virtual.loop.held
    virtual.loop.home(virtual.now)
    virtual.tick()
    assert virtual.loop.held
    virtual.becomes(State.READY, 120.0)
    virtual.tick(10)
    assert not virtual.loop.held


def test_a_row_is_held_in_a_fault_that_loses_the_stages_and_not_in_another(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.loop.stop(virtual.now, cause="a person")
    virtual.tick(10)
    assert not virtual.loop.held  # robot, tracker and sensors are looked at as ever
    virtual.fail("mute", "stages")
    virtual.becomes(State.FAULT)
    virtual.tick(10)
    assert virtual.loop.held
