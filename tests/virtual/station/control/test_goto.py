"""Motion to a pose (goto): after homing the loop approaches the pose and ends there without a tare.

A STOP ends both the homing and the approach.
"""

import numpy as np
import pytest

from station.config.motions import HoldMotion, Orders
from station.control.loop import Phase
from station.control.states import State
from station.control.task import MotionTask
from tests.harness.cases import a_case
from tests.harness.watched_bench import Bench

#: Start pose near the end of homing, so that homing is short [rad, rad, m].
NEAR_HOME = np.array([0.05, 0.05, -0.128])
TARGET = np.array([0.02, 0.3, -0.12])


@pytest.fixture
def bench() -> Bench:
    """Return a station that is READY near the pose at which homing ends."""
    bench = Bench(a_case("fig10", "feedforward"), NEAR_HOME)
    bench.ready()
    return bench


def there(bench: Bench) -> MotionTask:
    controller = bench.loop.controller
    return MotionTask(controller, Orders(HoldMotion(), controller.statics.robot), 0.0, TARGET, rests=False)


def until(bench: Bench, *states: State) -> None:
    while bench.loop.state not in states:
        assert bench.now < 60.0
        bench.tick()


def test_homing_continues_to_the_working_pose_without_the_state_ready_in_between(bench: Bench):
    bench.loop.home(bench.now, there(bench))
    until(bench, State.READY, State.RUNNING)
    assert bench.loop.state is State.RUNNING
    assert bench.loop.phase is Phase.APPROACHING
    until(bench, State.READY, State.HOLD, State.FAULT)
    assert (bench.loop.state, bench.loop.cause) == (State.READY, "")
    bench.tick(200)
    assert bench.of("joints")[-1] == pytest.approx(TARGET, abs=1e-3)
    # The loop sends no velocities during homing, so these velocities belong to the approach.
    velocities_sent = np.array([velocities for _, velocities in bench.stages.commands])
    assert (np.abs(velocities_sent) <= 0.5 * bench.loop.controller.limits.speed + 1e-9).all()


def test_goto_does_not_tare_the_sensors(bench: Bench):
    bench.tick(1000)  # wait until the tare after homing has ended
    bench.loop.start(there(bench))
    seen: set[Phase] = set()
    while bench.loop.state is State.RUNNING:
        seen.add(bench.loop.phase)
        bench.tick()
    assert seen == {Phase.APPROACHING}
    assert bench.loop.state is State.READY


@pytest.mark.parametrize("during", [State.HOMING, State.RUNNING])
def test_stop_ends_homing_the_approach_and_the_following_task(bench: Bench, during: State):
    bench.loop.home(bench.now, there(bench))
    until(bench, during)
    bench.tick(100)
    bench.loop.stop(bench.now)
    commands = len(bench.stages.commands)
    bench.tick(2000)
    assert bench.loop.state is (State.CONNECTED if during is State.HOMING else State.STOPPED)
    assert len(bench.stages.commands) == commands
    # The stopped task is not started after another homing.
    if during is State.HOMING:
        bench.loop.home(bench.now)
        until(bench, State.READY)
        bench.tick(50)
        assert bench.loop.state is State.READY
