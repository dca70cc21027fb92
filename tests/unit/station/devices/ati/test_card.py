"""Error messages on a computer without a card; tests of the card itself would need NI's driver and hardware."""

import importlib.util
import sys

import pytest

from station.devices.ati.nidaq import NiCard, device_of
from station.devices.links.link import LinkError, PortLock

SENSORS = [("Dev1/ai0:5", 10.0)]


def test_missing_package_is_reported_with_the_command_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(LinkError, match=r"Dev1: an NI card needs the package nidaqmx; .*'ctr-station\[nidaq\]'"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


@pytest.mark.skipif(importlib.util.find_spec("nidaqmx") is None, reason="the extra nidaq is not installed")
def test_missing_driver_or_card_names_the_inputs_and_releases_the_lock():
    with pytest.raises(LinkError, match=r"Dev1/ai0:5 cannot be sampled: .*"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


def test_card_is_named_by_its_inputs():
    assert device_of("cDAQ1Mod2/ai0:5") == "cDAQ1Mod2"
