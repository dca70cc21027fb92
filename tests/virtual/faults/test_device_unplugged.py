"""Unplugged stages cause FAULT; an unplugged tracker or force sensor causes HOLD. No motion resumes by itself.

A device that is plugged in again is identified by its serial number, or else by its USB socket.
"""

import pytest

from station.control.states import State
from station.control.task import Phase
from station.devices.links.link import UsbPort, find
from station.lab.aurora_commands import PortHandles
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(
    ("device", "state", "happened", "address"),
    [
        ("stages", State.FAULT, "the stage inner_translation cannot be reached", "zaber is gone"),
        ("tracker", State.HOLD, "the connection to the tracker is lost", "aurora is gone"),
        ("inner", State.HOLD, "force sensor 1 was silent for too long", "netft 1"),
    ],
)
def test_unplugged_device_ends_the_motion_and_its_return_does_not_resume_it(
    virtual: VirtualStation, device: str, state: State, happened: str, address: str
) -> None:
    virtual.moving()
    virtual.fail("disconnect", device)
    took = virtual.becomes(state)
    virtual.seconds(0.5)

    assert took <= 0.25
    assert happened in virtual.loop.cause
    assert address not in virtual.loop.cause
    assert address in virtual.loop.cause_details
    if device != "stages":
        assert virtual.rests()
    virtual.mend()
    virtual.seconds(3.0)
    assert (virtual.state, virtual.loop.phase) == (state, Phase.NONE)
    assert not virtual.of("velocity_commanded", virtual.rows[-1500:]).any()


@pytest.mark.parametrize("device", ["tracker", "outer"])
def test_reset_reconnects_a_returned_device_and_nothing_moves_before(virtual: VirtualStation, device: str) -> None:
    virtual.moving()
    virtual.fail("disconnect", device)
    virtual.becomes(State.HOLD)
    virtual.seconds(0.5)
    virtual.loop.reset(virtual.now)
    virtual.seconds(1.0)
    assert virtual.state is State.CONNECTING  # the device is still unplugged

    virtual.mend()
    virtual.becomes(State.READY)
    assert virtual.rests()
    virtual.moving()


def test_tracker_with_a_different_coil_stays_connecting_and_names_the_expected_coil(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("disconnect", "tracker")
    virtual.becomes(State.HOLD)
    virtual.lab.aurora.handles = PortHandles("OTHER123")
    virtual.mend()
    virtual.loop.reset(virtual.now)
    virtual.seconds(5.0)

    assert virtual.state is State.CONNECTING
    trouble = virtual.devices.tracker.trouble(virtual.now)
    assert trouble is not None
    assert "3A5C1D00" in trouble.text


def test_usb_adapter_is_identified_by_its_serial_number_or_else_by_its_socket() -> None:
    numbered = UsbPort("/dev/ttyUSB0", 0x0403, 0x6001, "A900", "1-1:1.0")
    nameless = UsbPort("/dev/ttyUSB1", 0x067B, 0x2303, "", "1-2:1.0")
    now = [
        UsbPort(
            "/dev/ttyUSB4", 0x0403, 0x6001, "B777", "1-1:1.0"
        ),  # another adapter in the socket of the first adapter
        UsbPort("/dev/ttyUSB5", 0x0403, 0x6001, "A900", "1-9:1.0"),  # the first adapter in another socket
        UsbPort("/dev/ttyUSB6", 0x067B, 0x2303, "", "1-3:1.0"),
        UsbPort("/dev/ttyUSB7", 0x067B, 0x2303, "", "1-2:1.0"),
    ]
    assert find(numbered, now) == "/dev/ttyUSB5"
    assert find(nameless, now) == "/dev/ttyUSB7"
    assert find(numbered, now[:1]) is None
