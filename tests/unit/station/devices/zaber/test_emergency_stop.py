"""Ports and units of the emergency stop."""

import pytest

from station.devices.zaber.emergency_stop import stage_units


@pytest.mark.parametrize(
    ("options", "units"),
    [
        ({"driver": "zaber", "port": "/dev/ttyUSB0"}, {"/dev/ttyUSB0": {1, 2, 3}}),
        (
            {"driver": "zaber", "joints": {"a": {"device": 1, "port": "COM3"}, "b": {"device": 1, "port": "COM4"}}},
            {"COM3": {1}, "COM4": {1}},
        ),
        (
            {"driver": "zaber", "port": "COM5", "joints": {"a": {"device": 1, "port": "COM3"}, "b": {"device": 2}}},
            {"COM3": {1}, "COM5": {2}},
        ),
        ({"driver": "zaber", "port": "COM5", "joints": {"a": {"device": 4}, "b": {"device": 2}}}, {"COM5": {2, 4}}),
    ],
)
def test_stage_units_are_grouped_by_port(options, units):
    assert stage_units(options, joints=3) == units
