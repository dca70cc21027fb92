"""Random setpoints and random changes of the stiffness at the same time, while a random load pushes the tip."""

import contextlib
import os

import numpy as np
import pytest

from core.control.setpoint_request import SetpointRequest
from core.control.stiffness import MAX_SPEED_M_S
from core.errors import DescriptionError
from station.config.controllers import PERIOD_S
from station.config.loads import RampLoad
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamLimits, StreamRequest
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation

#: `SEEDS=40 python -m pytest -n 0` with this file tries more.
SEEDS = int(os.environ.get("SEEDS", "2"))


@pytest.mark.parametrize("seed", range(SEEDS))
def test_streamed_tip_never_jumps_while_its_stiffness_changes(seed: int) -> None:
    random, limits = np.random.default_rng(seed), StreamLimits()
    virtual = VirtualStation(a_case("stiffness", "natural-x"), seed=seed).ready()
    virtual.loop.start(MotionTask(virtual.case.controller, limits, 60.0))
    virtual.until(lambda: virtual.loop.phase is Phase.MOVING, 30.0)
    start, position = len(virtual.rows), np.zeros(3)

    def request(now: float) -> StreamRequest:
        return StreamRequest(0, SetpointRequest(position, np.zeros(3), now, 0.0))

    virtual.request = request
    direction = random.normal(size=3)
    virtual.lab.apply_load(RampLoad(times=(0.0, 1.0), magnitudes=(0.0, 0.15), direction=tuple(direction)), virtual.now)
    for _ in range(12):
        position = random.uniform(-0.004, 0.004, 3)
        axes = 10.0 ** random.uniform(1.2, 3.2, 3)
        with contextlib.suppress(DescriptionError):  # too little stiffness for contact
            virtual.loop.set_stiffness(virtual.now, tuple(axes.tolist()))
        virtual.seconds(random.uniform(0.1, 0.6))
    desired = virtual.of("tip_desired")[start:]
    speed = np.linalg.norm(np.diff(desired, axis=0), axis=1).max() / PERIOD_S
    assert virtual.state is State.RUNNING, virtual.loop.cause
    assert speed < limits.bounds.max_speed + MAX_SPEED_M_S
