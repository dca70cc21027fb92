"""If a device reports that it is simulated, all stored data of this bench are marked as simulated."""

import pytest

from station.control.messages import DeviceStatus
from station.devices.interfaces import Condition, is_simulated
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from tests.harness.own_devices import OWN_DEVICES


@pytest.mark.parametrize(
    ("details", "expected"),
    [
        ({"tool": {"manufacturer": "simulated", "part": "001"}}, True),
        ({"inner": {"product": "Net F/T (simulated)"}}, True),
        ({"tool": {"manufacturer": "NDI"}, "frames": 12, "texts": ["a", 1]}, False),
        ({}, False),
    ],
)
def test_simulated_device_is_known_by_any_part_of_its_details(details: object, expected: bool) -> None:
    assert is_simulated(details) is expected


def test_bench_is_simulated_by_what_its_devices_report_and_not_by_its_file(write) -> None:
    """The drivers in a station file may be connected to a virtual lab through pseudo-terminals."""
    supervisor = Supervisor(load_station(write(OWN_DEVICES)).bench())
    try:
        assert not supervisor.simulated
        tool = {"tool": {"manufacturer": "simulated"}}
        supervisor._state.devices = (DeviceStatus("tracker", Condition.CONNECTED, 0, "", tool),)
        assert supervisor.simulated
    finally:
        supervisor.close()
