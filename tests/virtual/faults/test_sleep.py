"""After a sleep of the computer all axes stop, and the cause names the sleep before what it has led to."""

import numpy as np
import pytest

from station.config.motions import Orders
from station.control import sleep
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.service.commands import Home
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import CIRCLE, VirtualStation, usual_case

CAUSE = "this computer has slept for 12 s"
MEANWHILE = "; the stages may have moved meanwhile: check the robot"


@pytest.fixture
def station(monkeypatch: pytest.MonkeyPatch):
    asleep = [1000.0]
    monkeypatch.setattr(sleep, "time_asleep", lambda: asleep[0])
    with played_station(VirtualStation(usual_case())) as station:
        yield station, asleep


def slept(station: PlayedStation, asleep: list[float]) -> None:
    asleep[0] += 12.0
    station.tick()


def test_motion_ends_in_hold_after_sleep_and_a_later_fault_does_not_hide_it(station):
    played, asleep = station
    virtual = played.virtual
    virtual.loop.start(MotionTask(virtual.case.controller, Orders(CIRCLE, virtual.case.robot.robot()), 60.0))
    played.tick(2000)
    assert virtual.loop.phase is Phase.MOVING
    slept(played, asleep)
    assert played.state is State.HOLD
    played.tick(100)
    before = virtual.places
    played.tick(250)
    assert np.abs(virtual.places - before).max() < 1e-3  # rad, m
    virtual.fail("mute", "stages")
    played.becomes(State.FAULT)
    played.reported()
    assert played.supervisor.status().cause.startswith(f"{CAUSE}{MEANWHILE}; then the stage ")


def test_homing_ends_after_sleep(station):
    played, asleep = station
    played.supervisor.send(Home(way_is_clear=True, then_working_pose=False))
    played.tick(20)
    assert played.state is State.HOMING
    slept(played, asleep)
    assert played.state is State.CONNECTED
    assert played.virtual.loop.cause == CAUSE + MEANWHILE


def test_a_resting_station_names_the_sleep_and_a_stopped_one_remains_as_it_is(station):
    played, asleep = station
    slept(played, asleep)
    assert played.state is State.HOLD
    assert played.virtual.loop.cause == f"{CAUSE}: check the robot"
    played.reported()
    played.settle()
    played.supervisor.stop()
    slept(played, asleep)
    assert played.state is State.STOPPED
    assert CAUSE not in played.virtual.loop.cause
    played.settle()
    played.tick(500)
    assert played.state is State.READY
