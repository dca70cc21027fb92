"""In telemetry rows whose estimates the controller does not update, the channel `estimates_frozen` is 1."""

import numpy as np
import pytest

from station.config.motions import HoldMotion
from station.control.states import State
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture
def virtual() -> VirtualStation:
    """Return a station near the end of homing, so that homing is short."""
    return VirtualStation(usual_case()._replace(start=np.array([0.05, 0.05, -0.128])))


def frozen(virtual: VirtualStation) -> bool:
    return bool(virtual.loop.channels.of(virtual.rows[-1], "estimates_frozen")[0])


def test_telemetry_marks_estimates_as_frozen_exactly_during_homing(virtual: VirtualStation) -> None:
    virtual.becomes(State.READY)
    virtual.tick(10)
    assert not frozen(virtual)
    virtual.loop.home(virtual.now)
    virtual.tick()
    assert frozen(virtual)
    virtual.becomes(State.READY, 120.0)
    virtual.tick(10)
    assert not frozen(virtual)


def test_estimates_continue_after_a_stop_and_freeze_when_the_stages_are_lost(virtual: VirtualStation) -> None:
    virtual.moving(HoldMotion(), since=0.1)
    virtual.loop.stop(virtual.now, cause="a person")
    virtual.tick(10)
    assert not frozen(virtual)  # the estimates are still updated, because all devices are polled
    virtual.fail("mute", "stages")
    virtual.becomes(State.FAULT)
    virtual.tick(10)
    assert frozen(virtual)
