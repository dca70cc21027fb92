"""The endpoints of the live virtual lab are converted to a device configuration."""

import numpy as np
import pytest

from station.control.clock import StationClock
from station.devices.config import Mount
from station.devices.registry import plan
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig, TrackerConfig
from station.lab.lab_server import LabServer, devices_at


def test_endpoints_of_a_lab_give_a_valid_device_configuration(paper):
    config = LabConfig(tracker=TrackerConfig(rate=20.0, latency=0.030))
    with LabServer(paper, config, 0, np.array([0.2, 1.2, -0.08])) as lab:
        bench = devices_at(lab.endpoints, config)
        assert set(plan(bench, paper)) == {"stages", "tracker", "sensors"}
        assert bench.stages["port"] == lab.endpoints["zaber"]
        assert list(bench.sensors["tubes"]) == ["inner", "outer"]
    assert (bench.tracker["frame_rate"], bench.tracker["latency"]) == (20.0, 0.030)
    mount = Mount(**bench.tracker["mount"])
    assert mount.rotation == pytest.approx(GENERATOR_POSE.rotation, abs=1e-15)
    assert np.array(mount.position) == pytest.approx(GENERATOR_POSE.position)


def test_slow_clock_extends_the_timeouts_of_simulated_devices(paper):
    with LabServer(paper, LabConfig(), 0, np.array([0.2, 1.2, -0.08])) as lab:
        usual, patient = (
            devices_at(lab.endpoints, LabConfig(), clock) for clock in (StationClock(), StationClock(0.5, 2.0))
        )
    assert (usual.stages["deadline"], usual.sensors["stale_after"], usual.tracker["stale_after"]) == (0.15, 0.15, 0.25)
    assert {patient.stages["deadline"], patient.sensors["stale_after"], patient.tracker["stale_after"]} == {2.0}
