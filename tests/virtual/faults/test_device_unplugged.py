"""An unplugged tracker or force sensor causes HOLD, and no motion resumes by itself."""

import pytest

from station.control.states import State
from station.control.task import Phase
from station.lab.aurora_commands import PortHandles
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(
    ("device", "happened", "address"),
    [
        ("tracker", "the tracker is not connected", "aurora is gone"),
        ("inner", "force sensor 1 was silent for 0.05 s", "netft 1"),
    ],
)
def test_unplugged_device_ends_the_motion_which_does_not_resume_and_a_reset_reconnects_the_device(
    virtual: VirtualStation, device: str, happened: str, address: str
) -> None:
    virtual.moving()
    virtual.fail("disconnect", device)
    took = virtual.becomes(State.HOLD)
    virtual.seconds(0.3)

    assert took <= 0.25
    assert happened in virtual.loop.cause
    assert address not in virtual.loop.cause
    assert address in virtual.loop.cause_details
    assert virtual.rests()
    virtual.mend()
    since = len(virtual.rows)
    virtual.seconds(1.0)
    assert (virtual.state, virtual.loop.phase) == (State.HOLD, Phase.NONE)
    assert not virtual.of("velocity_commanded", virtual.rows[since:]).any()

    virtual.fail("disconnect", device)
    virtual.seconds(0.3)
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.CONNECTING  # the device is still unplugged
    virtual.mend()
    virtual.becomes(State.READY)
    assert virtual.rests()
    virtual.moving(since=0.1)


def test_tracker_with_a_different_coil_stays_connecting_and_names_the_expected_coil(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("disconnect", "tracker")
    virtual.becomes(State.HOLD)
    virtual.lab.aurora.handles = PortHandles("OTHER123")
    virtual.mend()
    virtual.loop.reset(virtual.now)
    virtual.seconds(2.0)

    assert virtual.state is State.CONNECTING
    trouble = virtual.devices.tracker.trouble(virtual.now)
    assert trouble is not None
    assert "3A5C1D00" in trouble.text
