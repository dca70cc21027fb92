"""Loads and faults of a run are applied from the start to the end of its motion, and only in the virtual lab."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.control.process import ring_width
from station.control.ring import Ring
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer, devices_at
from station.service.processes import Backend
from station.service.station_file import load_station

MUTE = LabFault(kind="mute", device="stages")


@pytest.fixture
def ring(paper) -> Iterator[Ring]:
    ring = Ring(ring_width(paper))
    yield ring
    ring.close(remove=True)


def test_faults_can_be_injected_into_simulated_devices_only(paper, ring):
    with LabServer(paper, LabConfig(), 0, np.array([0.0, np.pi / 2.0, -0.1])) as lab:
        devices = devices_at(lab.endpoints, LabConfig())
    side = Backend(replace(load_station(None).bench(), devices=devices), ring)
    side.open()

    assert side.alive
    assert side.pid is None
    assert side.devices() == devices
    side.inject(())  # an empty sequence is allowed with real devices, because it only clears faults
    for call in (side.check, side.inject):
        with pytest.raises(ConfigError, match="virtual lab only"):
            call([MUTE])
