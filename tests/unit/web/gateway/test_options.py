"""Gateway options of the command line."""

import sys

import pytest

from web.cli import main
from web.gateway.options import GatewayError, GatewayOptions, ListenAddress, address_of

LOOPBACK = ListenAddress("127.0.0.1", 18944)


def test_the_default_host_of_the_gateway_is_loopback():
    assert address_of("18944") == LOOPBACK
    assert address_of(":18944") == LOOPBACK
    assert address_of("0.0.0.0:1") == ListenAddress("0.0.0.0", 1)
    assert address_of("[::1]:0") == ListenAddress("::1", 0)
    assert str(address_of("[::1]:7")) == "[::1]:7"


@pytest.mark.parametrize("text", ["", "a", "1.2.3.4", "host:", "host:x", "70000", "-1"])
def test_an_invalid_gateway_port_is_refused_by_the_command_line(text, capsys):
    with pytest.raises(ValueError, match=r"invalid literal|outside 0"):
        address_of(text)
    with pytest.raises(SystemExit):
        main(["serve", f"--igtl={text}"])
    assert "--igtl" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wanted", "package", "extra"),
    [
        (GatewayOptions(igtl=LOOPBACK), "pyigtl", "igtl"),
        (GatewayOptions(lsl=True), "pylsl", "lsl"),
        (GatewayOptions(ros2=LOOPBACK), "zenoh", "ros2"),
    ],
)
def test_a_missing_gateway_package_is_reported_with_its_extra(wanted, package, extra, monkeypatch):
    wanted.check()
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(GatewayError, match=rf"--{extra} needs the package {package}: .*'ctr-station\[{extra}\]'"):
        wanted.check()
    GatewayOptions(foxglove=LOOPBACK).check()
