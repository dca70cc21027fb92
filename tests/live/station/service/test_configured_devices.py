"""A station with configured devices; here they belong to a lab that is independent of the station."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.control.states import State
from station.lab.config import LabConfig
from station.lab.lab_server import LabServer, devices_at
from station.service.commands import Home
from station.service.fallback_stop import NO_STAGES
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from tests.harness.running_lab import running
from tests.harness.waiting import NET

PARK = np.array([0.0, np.pi / 2.0, -0.1])


@pytest.fixture
def grace() -> float:
    return 10.0


def test_station_with_real_devices_waits_for_home(paper, tmp_path: Path):
    with running(LabServer(paper, LabConfig(), 0, PARK)) as lab:
        told = devices_at(lab.endpoints, LabConfig())
        patient = told.model_copy(update={"stages": {**told.stages, "deadline": 2.0}})
        supervisor = Supervisor(replace(load_station(None).bench(), devices=patient), tmp_path)
        try:
            supervisor.open()
            supervisor.wait_ready(NET)
            status = supervisor.status()
            assert status.state is State.CONNECTED, status.cause
            assert dict(status.values) == {}  # there is no telemetry before the stages are homed
            supervisor.send(Home(way_is_clear=True, then_working_pose=False))
            give_up = time.monotonic() + 10.0
            while supervisor.status().state is State.CONNECTED and time.monotonic() < give_up:
                time.sleep(0.01)
            assert supervisor.status().state is State.HOMING
            assert supervisor.stop() == NO_STAGES
        finally:
            supervisor.close()
