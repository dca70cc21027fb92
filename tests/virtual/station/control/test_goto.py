"""After homing the loop carries out what follows: the way to a pose, which ends there, untared; a stop ends both."""

import numpy as np
import pytest

from station.config.motions import HoldMotion, Orders
from station.control.loop import Phase
from station.control.states import State
from station.control.task import Task
from tests.harness.cases import a_case
from tests.harness.watched_bench import Bench

#: Near where homing ends, so that homing is short [rad, rad, m].
NEAR_HOME = np.array([0.05, 0.05, -0.128])
TARGET = np.array([0.02, 0.3, -0.12])


@pytest.fixture
def bench() -> Bench:
    """READY near where homing ends."""
    bench = Bench(a_case("fig10", "feedforward"), NEAR_HOME)
    bench.ready()
    return bench


def there(bench: Bench) -> Task:
    controller = bench.loop.controller
    return Task(controller, Orders(HoldMotion(), controller.statics.robot), 0.0, TARGET, rests=False)


def until(bench: Bench, *states: State) -> None:
    while bench.loop.state not in states:
        assert bench.now < 60.0
        bench.tick()


def test_homing_goes_on_to_the_pose_without_a_moment_of_ready_between(bench: Bench):
    bench.loop.home(bench.now, there(bench))
    until(bench, State.READY, State.RUNNING)
    assert bench.loop.state is State.RUNNING
    assert bench.loop.phase is Phase.APPROACHING
    until(bench, State.READY, State.HOLD, State.FAULT)
    assert (bench.loop.state, bench.loop.cause) == (State.READY, "")
    bench.tick(200)
    assert bench.of("joints")[-1] == pytest.approx(TARGET, abs=1e-3)
    # Homing itself ends with rotations at zero, retracted: what came after was the way.
    ways = np.array([velocities for _, velocities in bench.stages.commands])
    assert (np.abs(ways) <= 0.5 * bench.loop.controller.limits.speed + 1e-9).all()


def test_going_there_does_not_zero_the_sensors(bench: Bench):
    bench.tick(1000)  # what is tared once homed is over
    bench.loop.start(there(bench))
    seen: set[Phase] = set()
    while bench.loop.state is State.RUNNING:
        seen.add(bench.loop.phase)
        bench.tick()
    assert seen == {Phase.APPROACHING}
    assert bench.loop.state is State.READY


@pytest.mark.parametrize("during", [State.HOMING, State.RUNNING])
def test_a_stop_ends_homing_and_the_way_and_what_would_follow(bench: Bench, during: State):
    bench.loop.home(bench.now, there(bench))
    until(bench, during)
    bench.tick(100)
    bench.loop.stop(bench.now)
    commands = len(bench.stages.commands)
    bench.tick(2000)
    assert bench.loop.state is (State.CONNECTED if during is State.HOMING else State.STOPPED)
    assert len(bench.stages.commands) == commands
    # Homed once more nothing follows by itself.
    if during is State.HOMING:
        bench.loop.home(bench.now)
        until(bench, State.READY)
        bench.tick(50)
        assert bench.loop.state is State.READY
