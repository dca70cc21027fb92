"""Force sensor saturated or its status bad: the sample never enters control, is never clamped into it; HOLD."""

import numpy as np
import pytest

from station.config.controllers import PERIOD
from station.control.states import State
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(
    ("kind", "said"),
    [("saturate", "saturated"), ("bad_status", "status"), ("mute", "stale"), ("restart", "stale")],
)
def test_its_sample_never_enters_control(virtual: VirtualStation, kind: str, said: str) -> None:
    virtual.moving()
    before = len(virtual.rows)
    usual = np.abs(virtual.of("wrench_raw")[-500:]).max(axis=0)
    virtual.fail(kind, "inner")
    took = virtual.becomes(State.HOLD)
    virtual.seconds(0.5)

    assert took <= 0.06  # 50 ms without a record count as silence; everything else shows at the next one
    assert "force sensor 1 (netft 1): " in virtual.loop.cause
    assert said in virtual.loop.cause
    # the last good one stands: nothing near full scale (18 N, 0.25 N m) came through
    assert (np.abs(virtual.of("wrench_raw", virtual.rows[before:])).max(axis=0) < usual + 0.2).all()
    assert np.abs(virtual.of("force", virtual.rows[before:])).max() < 0.3
    assert virtual.rests()


def test_it_stays_held_until_a_person_resets_it(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("saturate", "outer")
    virtual.becomes(State.HOLD)
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.CONNECTING  # it is still saturated
    virtual.mend()
    virtual.becomes(State.READY, 1.0)


def test_a_box_that_has_started_anew_is_not_taken_for_the_one_that_was_tared(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("restart", "inner")
    virtual.becomes(State.HOLD)
    virtual.seconds(3.0)
    trouble = virtual.devices.sensors.trouble(virtual.now)
    assert trouble is not None
    assert "reset" in trouble.text
    virtual.loop.reset(virtual.now)
    virtual.becomes(State.READY, 1.0)


def test_a_sensor_that_repeats_itself_is_silent(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("freeze", "inner")
    took = virtual.becomes(State.HOLD)

    assert took <= 0.05 + 3 * PERIOD
    assert "stale" in virtual.loop.cause
