"""A serial line in memory, and the effect of an unplugged cable on both ends."""

import pytest

from station.devices.links.link import LinkError, reopen
from station.lab.wires import BUFFER_BYTES, HostPort


def test_line_transfers_bytes_in_both_directions_in_order():
    host = HostPort("line")
    device = host.device
    host.write(b"ab")
    host.write(b"c")
    device.write(b"xy")
    assert device.read() == b"abc"
    assert host.read() == b"xy"
    assert (host.read(), device.read()) == (b"", b"")


def test_unread_bytes_of_a_line_are_limited():
    host = HostPort("line")
    host.write(b"x" * 3 * BUFFER_BYTES)
    host.device.write(b"y" * 3 * BUFFER_BYTES)
    assert host.device.read() == b"x" * BUFFER_BYTES
    assert host.read() == b"y" * BUFFER_BYTES


def test_replugged_link_must_be_reopened_and_drops_old_bytes():
    host = HostPort("line")
    device = host.device
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
    host = HostPort("line")
    device = host.device
    host.close()
    with pytest.raises(LinkError, match="closed"):
        host.read()
    device.write(b"unread")  # a device does not detect this
    reopen(host)
    host.write(b"x")
    assert device.read() == b"x"


def test_link_that_cannot_be_reopened_raises():
    device = HostPort("line").device
    with pytest.raises(LinkError, match=r"line \(device\) cannot be opened again"):
        reopen(device)
