"""A force sensor that is saturated, silent or reports a bad status causes HOLD.

The controller never uses a sample of such a sensor, not even a sample clamped to the sensor's range.
"""

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.states import State
from tests.harness.virtual_station import VirtualStation


@pytest.mark.parametrize(("kind", "said"), [("saturate", "saturated"), ("bad_status", "device fault")])
def test_sample_of_a_faulty_force_sensor_never_enters_control(virtual: VirtualStation, kind: str, said: str) -> None:
    virtual.moving()
    before = len(virtual.rows)
    usual = np.abs(virtual.of("wrench_raw")[-500:]).max(axis=0)
    virtual.fail(kind, "inner")
    took = virtual.becomes(State.HOLD)
    virtual.seconds(0.5)

    assert took <= 0.01  # the fault is visible in the next record
    assert "force sensor 1 on netft 1: " in virtual.loop.cause_details
    assert said in virtual.loop.cause_details
    assert virtual.loop.cause.startswith("force sensor 1 ")
    # The last valid sample is repeated, so no value is near the full scale of 18 N and 0.25 N m.
    assert (np.abs(virtual.of("wrench_raw", virtual.rows[before:])).max(axis=0) < usual + 0.2).all()
    assert np.abs(virtual.of("force", virtual.rows[before:])).max() < 0.3
    assert virtual.rests()


def test_station_is_ready_again_only_after_a_reset_and_the_end_of_the_saturation(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("saturate", "outer")
    virtual.becomes(State.HOLD)
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.CONNECTING  # the sensor is still saturated
    virtual.mend()
    virtual.becomes(State.READY, 1.0)


def test_restarted_force_sensor_box_is_not_used_before_a_reset(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("restart", "inner")
    virtual.becomes(State.HOLD)
    virtual.seconds(1.0)
    trouble = virtual.devices.sensors.trouble(virtual.now)
    assert trouble is not None
    assert "restarted" in trouble.text
    virtual.loop.reset(virtual.now)
    virtual.becomes(State.READY, 1.0)


def test_force_sensor_that_repeats_its_sample_counts_as_silent(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("freeze", "inner")
    took = virtual.becomes(State.HOLD)

    assert took <= 0.05 + 3 * PERIOD_S
    assert virtual.loop.cause.startswith("force sensor 1 sends 00 00 ")
    assert "(36 bytes), whose counters do not continue" in virtual.loop.cause
