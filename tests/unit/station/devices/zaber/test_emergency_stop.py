"""Ports and units of the emergency stop."""

import itertools
from types import SimpleNamespace

import pytest

from station.devices.interfaces import NotStopped
from station.devices.zaber.stages import ZABER


def test_emergency_stop_names_the_stages_of_each_port(paper):
    places = ({"device": 1, "port": "COM3"}, {"device": 1, "port": "COM4"}, {"device": 2})
    joints = dict(zip((joint.name for joint in paper.joints), places, strict=True))
    stop = ZABER.emergency_stop({"port": "COM4", "joints": joints}, paper)
    with pytest.raises(
        NotStopped, match=r"stages on COM3 cannot be .*; the stages on COM4 cannot be commanded to stop"
    ):
        stop(SimpleNamespace(now=itertools.count().__next__, sleep=lambda _: None))
