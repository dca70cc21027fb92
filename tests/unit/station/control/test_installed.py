"""What an installed driver does wrong is told by its name."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from core.errors import CtrError
from station.control.clock import REAL_TIME
from station.control.installed import LONG, Calls, DriverError, called, named
from station.control.ring import Ring
from station.devices.config import BenchFile
from station.devices.interfaces import Condition, Devices

BENCH = BenchFile(stages={"driver": "line-stages"}, tracker={"driver": "aurora"}, sensors={"driver": "netft"})


class Stages:
    """Of somebody who has read half of the contract."""

    condition = Condition.CONNECTED

    def __init__(self, ring: Ring) -> None:
        self.seen = ""
        self._ring = ring

    @property
    def ready(self) -> bool:
        raise KeyError("ready")

    def home(self, now: float) -> None:
        raise CtrError("these stages need no homing")

    def poll(self, now: float) -> Any:
        raise ZeroDivisionError("division by zero")

    def command(self, velocities: Any, now: float) -> None:
        self.seen = called(self._ring, BENCH)
        REAL_TIME.sleep(2.0 * LONG)


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring(1)
    yield ring
    ring.close(remove=True)


def test_driver_method_and_exception_are_named(ring: Ring) -> None:
    stages = named(Devices(Stages(ring), None, None), BENCH, Calls(ring, REAL_TIME)).stages

    with pytest.raises(
        DriverError, match=r"driver 'line-stages' of devices\.stages: poll raised ZeroDivisionError: div"
    ):
        stages.poll(0.0)
    with pytest.raises(DriverError, match="ready raised KeyError"):
        _ = stages.ready
    assert stages.condition is Condition.CONNECTED
    with pytest.raises(CtrError) as refused:
        stages.home(0.0)
    assert not isinstance(refused.value, DriverError)  # it may say that


def test_whoever_makes_the_loop_wait_is_named_meanwhile_and_afterwards(ring: Ring) -> None:
    device, calls = Stages(ring), Calls(ring, REAL_TIME)
    stages = named(Devices(device, None, None), BENCH, calls).stages
    stages.command(np.zeros(3), 0.0)

    assert device.seen == "driver 'line-stages' of devices.stages"
    assert called(ring, BENCH) == ""
    assert calls.longest().startswith("driver 'line-stages' of devices.stages: command took ")
    assert calls.longest() == ""


def test_the_stations_own_drivers_are_left_as_they_are(ring: Ring) -> None:
    own = BenchFile(stages={"driver": "zaber"}, tracker={"driver": "aurora"}, sensors={"driver": "netft"})
    stages = Stages(ring)
    assert named(Devices(stages, None, None), own, Calls(ring, REAL_TIME)).stages is stages
