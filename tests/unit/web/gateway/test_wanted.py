"""What of the gateway is asked for on the command line."""

import sys

import pytest

from web.cli import main
from web.gateway.wanted import Address, GatewayError, Wanted, address_of

LOOPBACK = Address("127.0.0.1", 18944)


def test_without_a_host_it_is_loopback():
    assert address_of("18944") == LOOPBACK
    assert address_of(":18944") == LOOPBACK
    assert address_of("0.0.0.0:1") == Address("0.0.0.0", 1)
    assert address_of("[::1]:0") == Address("::1", 0)
    assert str(address_of("[::1]:7")) == "[::1]:7"


@pytest.mark.parametrize("text", ["", "a", "1.2.3.4", "host:", "host:x", "70000", "-1"])
def test_what_is_no_port_is_refused_by_the_command_line(text, capsys):
    with pytest.raises(ValueError, match=r"invalid literal|outside 0"):
        address_of(text)
    with pytest.raises(SystemExit):
        main(["serve", f"--igtl={text}"])
    assert "--igtl" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wanted", "package", "extra"),
    [
        (Wanted(igtl=LOOPBACK), "pyigtl", "igtl"),
        (Wanted(lsl=True), "pylsl", "lsl"),
        (Wanted(ros2=LOOPBACK), "zenoh", "ros2"),
    ],
)
def test_a_missing_package_is_said_with_its_extra(wanted, package, extra, monkeypatch):
    wanted.check()
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(GatewayError, match=rf"--{extra} needs the package {package}: .*'ctr-station\[{extra}\]'"):
        wanted.check()
    Wanted(foxglove=LOOPBACK).check()
