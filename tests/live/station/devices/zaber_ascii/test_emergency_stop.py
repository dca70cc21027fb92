"""The emergency stop of Zaber ASCII stages on a real pseudo-terminal."""

from collections.abc import Iterator

import numpy as np
import pytest

from station.control.clock import REAL_TIME_CLOCK
from station.devices.interfaces import NotStopped
from station.devices.links.link import SerialLink
from station.devices.zaber_ascii.emergency_stop import stop_axes
from station.devices.zaber_ascii.protocol import BAUD, encode
from station.lab.config import LabConfig
from station.lab.lab_server import LabServer
from tests.harness.running_lab import running
from tests.harness.waiting import until

AXES = {(1, 1), (2, 1), (3, 1)}


@pytest.fixture
def lab(paper) -> Iterator[LabServer]:
    config, park = LabConfig(stages="zaber_ascii"), np.array([0.2, 1.2, -0.08])
    with running(LabServer(paper, config, 0, park, pty=True, homed=True)) as lab:
        yield lab


def test_emergency_stop_stops_every_axis_after_half_a_line(lab):
    port, units = lab.endpoints["zaber_ascii"], lab.lab.chain.units
    link = SerialLink(port, BAUD)
    link.write(b"".join(encode(device, 1, device, "move vel -20000") for device in (1, 2, 3)) + b"/1 1 move")
    assert until(lambda: all(unit.motor.moving for unit in units))
    link.close()
    assert stop_axes(port, AXES, REAL_TIME_CLOCK).startswith(f"3 stages on {port} stop, commanded ")
    assert until(lambda: not any(unit.motor.moving for unit in units))


def test_emergency_stop_names_the_device_that_does_not_answer(lab):
    with pytest.raises(NotStopped, match="number 9 was commanded to stop and has not confirmed"):
        stop_axes(lab.endpoints["zaber_ascii"], {(1, 1), (9, 1)}, REAL_TIME_CLOCK, patience=0.3)
