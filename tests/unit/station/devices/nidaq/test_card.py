"""A card that is not there: what a person is told. The card itself needs NI's driver and hardware."""

import importlib.util
import sys

import pytest

from station.devices.links.link import LinkError
from station.devices.links.port_lock import PortLock
from station.devices.nidaq.card import NiCard, device_of

SENSORS = [("Dev1/ai0:5", 10.0)]


def test_without_the_package_a_person_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(LinkError, match=r"Dev1: an NI card needs the package nidaqmx; .*'ctr-station\[nidaq\]'"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


@pytest.mark.skipif(importlib.util.find_spec("nidaqmx") is None, reason="the extra nidaq is not installed")
def test_without_nis_driver_or_card_the_inputs_are_named_and_nothing_is_held():
    with pytest.raises(LinkError, match=r"Dev1/ai0:5 cannot be sampled: .*"):
        NiCard(SENSORS, 5000.0)
    PortLock("nidaq://Dev1").release()


def test_the_card_of_some_inputs():
    assert device_of("cDAQ1Mod2/ai0:5") == "cDAQ1Mod2"
