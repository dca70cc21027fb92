"""A pipe in memory, and the effect of an unplugged cable on both ends."""

import pytest

from station.devices.links.link import LinkError, reopen
from station.devices.links.memory_pipe import MAX_PENDING_WRITES, memory_pipe


def test_pipe_transfers_bytes_in_both_directions_in_order():
    host, device = memory_pipe("line")
    host.write(b"ab")
    host.write(b"c")
    device.write(b"xy")
    assert device.read() == b"abc"
    assert host.read() == b"xy"
    assert (host.read(), device.read()) == (b"", b"")


def test_unread_bytes_of_a_pipe_are_limited():
    host, device = memory_pipe("line")
    for k in range(3 * MAX_PENDING_WRITES):
        device.write(bytes((k % 256,)))
        host.write(b"x")

    assert host.read() == bytes(k % 256 for k in range(2 * MAX_PENDING_WRITES, 3 * MAX_PENDING_WRITES))
    assert len(device.read()) == MAX_PENDING_WRITES


def test_unplugged_cable_raises_for_the_host_and_is_silent_for_the_device():
    host, device = memory_pipe("line")
    device.unplug()
    for use in (host.read, lambda: host.write(b"x"), lambda: reopen(host)):
        with pytest.raises(LinkError, match=r"line .*plugged"):
            use()
    device.write(b"lost")
    assert device.read() == b""


def test_replugged_link_must_be_reopened_and_drops_old_bytes():
    host, device = memory_pipe("line")
    host.write(b"in transit")
    device.write(b"unread")
    device.unplug()
    device.plug()
    with pytest.raises(LinkError, match="gone"):
        host.read()
    assert reopen(host) is host
    assert host.read() == b""
    host.write(b"new")
    assert device.read() == b"new"


def test_closed_link_stays_closed_until_it_is_reopened():
    host, device = memory_pipe("line")
    host.close()
    with pytest.raises(LinkError, match="closed"):
        host.read()
    device.write(b"unread")  # a device does not detect this
    reopen(host)
    host.write(b"x")
    assert device.read() == b"x"


def test_link_that_cannot_be_reopened_raises():
    _, device = memory_pipe("line")
    with pytest.raises(LinkError, match=r"line \(device\) cannot be opened again"):
        reopen(device)
