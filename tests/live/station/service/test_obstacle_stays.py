"""An obstacle of the live virtual lab keeps its position after its run until it is removed."""

from collections.abc import Iterator

import numpy as np
import pytest

from station.config.controllers import ControllerFile
from station.config.loads import ConstantLoad, Load, NoLoad, WallLoad
from station.config.motions import HoldMotion, Orders
from station.config.robots import RobotFile
from station.control.process import ring_width
from station.control.ring import LAB_HEARTBEAT, Ring
from station.control.task import MotionTask
from station.service.processes import Backend
from station.service.runs import StartRequest
from station.service.station_file import load_station
from tests.harness.calm import CLOCK, SETTINGS
from tests.harness.waiting import until

#: A wall whose surface is 2 mm behind the tip at the start of the run, so that it pushes the tip at once.
WALL = WallLoad(direction=(-1.0, 0.0, 0.0), distance=-0.002, stiffness=500.0)


@pytest.fixture
def ring(paper: RobotFile) -> Iterator[Ring]:
    ring = Ring(ring_width(paper))
    yield ring
    ring.close(remove=True)


@pytest.fixture
def lab(ring: Ring) -> Iterator[Backend]:
    lab = Backend(load_station(None, SETTINGS).bench(), ring)
    lab.open()
    lab.devices()
    yield lab
    lab.close()


def test_obstacle_stays_after_its_run_until_it_is_removed(lab: Backend, ring: Ring, paper: RobotFile) -> None:
    task = MotionTask(ControllerFile().controller(paper), Orders(HoldMotion(), paper.robot()), 60.0)

    def force() -> float:
        """Return the true force [N] after the lab has processed all messages."""
        sent = CLOCK.now()
        until(lambda: ring.numbers[LAB_HEARTBEAT] > sent + 0.02)
        truth = until(ring.truth)  # None until it was read once between two of the lab's writes
        return float(np.linalg.norm(truth.force))

    def run(load: Load) -> None:
        lab.motion(StartRequest(task, "hold", load=load), CLOCK.now())

    assert force() == 0.0
    run(WALL)
    pushed = until(force)
    lab.motion(None, None)
    assert force() == pytest.approx(pushed, rel=0.1)
    run(NoLoad())  # a run without load leaves the obstacle
    assert force() == pytest.approx(pushed, rel=0.1)
    lab.motion(None, None)
    assert force() == pytest.approx(pushed, rel=0.1)
    lab.apply_load(NoLoad())
    assert force() == 0.0
    run(ConstantLoad(magnitude=0.1))  # any other load ends with its run
    assert until(force) == pytest.approx(0.1)
    lab.motion(None, None)
    assert force() == 0.0
