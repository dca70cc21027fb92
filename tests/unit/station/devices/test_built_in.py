"""Where the stages can be told to stop without their driver."""

import pytest

from station.devices.built_in import stage_ports


@pytest.mark.parametrize(
    ("options", "ports"),
    [
        ({"driver": "zaber", "port": "/dev/ttyUSB0"}, ("/dev/ttyUSB0",)),
        (
            {"driver": "zaber", "joints": {"a": {"device": 1, "port": "COM3"}, "b": {"device": 1, "port": "COM4"}}},
            ("COM3", "COM4"),
        ),
        (
            {"driver": "zaber", "port": "COM5", "joints": {"a": {"device": 1, "port": "COM3"}, "b": {"device": 2}}},
            ("COM3", "COM5"),
        ),
        ({"driver": "zaber", "port": "COM5", "joints": {"a": {"device": 1}, "b": {"device": 2}}}, ("COM5",)),
        ({"driver": "mine", "port": "COM5"}, ()),
    ],
)
def test_the_ports_of_the_stages(options, ports):
    assert stage_ports(options) == ports
