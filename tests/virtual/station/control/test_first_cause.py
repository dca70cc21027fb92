"""Later events do not remove the cause of a fault before a reset."""

import pytest

from station.control.states import State, Transition
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture
def virtual() -> VirtualStation:
    return VirtualStation(usual_case())


def test_stop_in_fault_keeps_the_cause_and_is_appended(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("mute", "stages")
    virtual.becomes(State.FAULT)
    first = virtual.loop.cause
    virtual.loop.stop(virtual.now, cause="stopped by a viewer, 'Anna'")
    virtual.loop.stop(virtual.now, cause="stopped by a viewer, 'Anna'")

    assert virtual.loop.cause == f"{first}; then stopped by a viewer, 'Anna'"
    virtual.seconds(0.4)  # wait until the other axes miss their polls, too: they are also named
    assert "the stage outer_rotation cannot be reached" in virtual.loop.cause
    assert virtual.loop.cause.endswith("; then stopped by a viewer, 'Anna'")
    virtual.mend()
    virtual.seconds(0.5)
    virtual.loop.reset(virtual.now)
    assert virtual.loop.cause == ""


def test_cause_of_a_hold_is_kept_by_a_later_stop_and_fault(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.loop.stop(virtual.now, Transition.HOLD, "the tracker is silent")
    virtual.loop.stop(virtual.now)
    virtual.loop.stop(virtual.now, Transition.FAULT, "the line is cut")

    assert virtual.state is State.FAULT
    assert virtual.loop.cause == "the tracker is silent; then stopped by the operator; then the line is cut"


def test_cause_of_a_fault_does_not_contain_an_earlier_stop_in_another_state(virtual: VirtualStation) -> None:
    virtual.becomes(State.READY)
    virtual.loop.home(virtual.now)
    virtual.loop.stop(virtual.now)
    assert virtual.state is State.CONNECTED
    virtual.loop.stop(virtual.now, Transition.FAULT, "the line is cut")

    assert virtual.loop.cause == "the line is cut"
