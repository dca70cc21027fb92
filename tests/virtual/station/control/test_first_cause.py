"""Nothing that follows a fault takes its cause away before somebody has reset it."""

import pytest

from station.control.states import Event, State
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture
def virtual() -> VirtualStation:
    return VirtualStation(usual_case())


def test_a_stop_in_fault_leaves_the_cause_and_is_added_to_it(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("mute", "stages")
    virtual.becomes(State.FAULT)
    first = virtual.loop.cause
    virtual.loop.stop(virtual.now, cause="stopped by a viewer, 'Anna'")
    virtual.loop.stop(virtual.now, cause="stopped by a viewer, 'Anna'")

    assert virtual.loop.cause == f"{first}; then stopped by a viewer, 'Anna'"
    virtual.seconds(0.4)  # the axes that are missed later are named all the same
    assert "outer_rotation (device" in virtual.loop.cause
    assert virtual.loop.cause.endswith("; then stopped by a viewer, 'Anna'")
    virtual.mend()
    virtual.seconds(0.5)
    virtual.loop.reset(virtual.now)
    assert virtual.loop.cause == ""


def test_a_hold_is_remembered_by_the_stop_and_the_fault_after_it(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.loop.stop(virtual.now, Event.HOLD, "the tracker is silent")
    virtual.loop.stop(virtual.now)
    virtual.loop.stop(virtual.now, Event.FAULT, "the line is cut")

    assert virtual.state is State.FAULT
    assert virtual.loop.cause == "the tracker is silent; then stopped by the operator; then the line is cut"


def test_a_stop_of_something_that_needs_no_reset_is_no_cause_of_a_later_fault(virtual: VirtualStation) -> None:
    virtual.becomes(State.READY)
    virtual.loop.home(virtual.now)
    virtual.loop.stop(virtual.now)
    assert virtual.state is State.CONNECTED
    virtual.loop.stop(virtual.now, Event.FAULT, "the line is cut")

    assert virtual.loop.cause == "the line is cut"
