"""A pipe in memory, and what pulling its cable does to either end."""

import pytest

from station.devices.links.link import LinkError, reopen
from station.devices.links.memory_pipe import MOST_WAITING, memory_pipe


def test_bytes_go_both_ways_in_order():
    host, device = memory_pipe("line")
    host.write(b"ab")
    host.write(b"c")
    device.write(b"xy")
    assert device.read() == b"abc"
    assert host.read() == b"xy"
    assert (host.read(), device.read()) == (b"", b"")


def test_what_nobody_reads_does_not_pile_up():
    host, device = memory_pipe("line")
    for k in range(3 * MOST_WAITING):
        device.write(bytes((k % 256,)))
        host.write(b"x")

    assert host.read() == bytes(k % 256 for k in range(2 * MOST_WAITING, 3 * MOST_WAITING))
    assert len(device.read()) == MOST_WAITING


def test_a_pulled_cable_is_a_dead_port_for_the_host_and_silence_for_the_device():
    host, device = memory_pipe("line")
    device.unplug()
    for use in (host.read, lambda: host.write(b"x"), lambda: reopen(host)):
        with pytest.raises(LinkError, match=r"line .*plugged"):
            use()
    device.write(b"lost")
    assert device.read() == b""


def test_plugged_in_again_the_host_has_to_open_it_anew_and_nothing_old_comes():
    host, device = memory_pipe("line")
    host.write(b"on its way")
    device.write(b"unread")
    device.unplug()
    device.plug()
    with pytest.raises(LinkError, match="gone"):
        host.read()
    assert reopen(host) is host
    assert host.read() == b""
    host.write(b"new")
    assert device.read() == b"new"


def test_a_closed_link_is_closed_until_it_is_opened_anew():
    host, device = memory_pipe("line")
    host.close()
    with pytest.raises(LinkError, match="closed"):
        host.read()
    device.write(b"for nobody")  # a device does not know
    reopen(host)
    host.write(b"x")
    assert device.read() == b"x"


def test_a_link_that_cannot_come_back_says_so():
    _, device = memory_pipe("line")
    with pytest.raises(LinkError, match=r"line \(device\) cannot be opened anew"):
        reopen(device)
