"""A reading or command with NaN or infinity is never sent to the stages; every axis stops, and the state is HOLD."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.states import State
from station.control.task import Phase
from station.devices.interfaces import Devices
from tests.harness.virtual_station import VirtualStation


class Spoilt:
    """Driver whose readings are `bad` (NaN or infinity) after the test has set that value."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self.bad: float | None = None

    def poll(self, now: float) -> Any:
        reading = self.device.poll(now)
        if reading is None or self.bad is None:
            return reading
        return type(reading)(*(np.full_like(x, self.bad) if isinstance(x, np.ndarray) else x for x in reading))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.device, name)


@pytest.mark.parametrize(
    ("device", "named", "bad"),
    [
        ("stages", "the stages ", np.nan),
        ("stages", "the stages ", -np.inf),
        ("tracker", "the tracker ", np.inf),
        ("sensors", "the force sensors ", np.nan),
    ],
)
def test_reading_that_is_not_finite_stops_every_axis_and_no_velocity_is_sent(
    virtual: VirtualStation, device: str, named: str, bad: float
) -> None:
    spoilt = Spoilt(getattr(virtual.devices, device))
    devices: Devices = replace(virtual.devices, **{device: spoilt})
    virtual.loop.devices = devices
    virtual.moving()
    begin = len(virtual.rows)
    spoilt.bad = bad
    took = virtual.becomes(State.HOLD)

    assert took <= (0.025 if device == "tracker" else 0.0) + 2 * PERIOD_S
    assert virtual.loop.cause.startswith(f"{named}reported ")
    assert str(bad).removeprefix("-") in virtual.loop.cause_details
    assert "\n" not in virtual.loop.cause
    virtual.seconds(0.4)
    since = virtual.rows[begin + round(took / PERIOD_S) :]
    assert not virtual.of("velocity_commanded", since).any()
    # The rows mark estimates that the controller did not update.
    assert virtual.of("estimates_frozen", since).all() == (device != "tracker")
    assert not virtual.of("estimates_frozen", virtual.rows[:begin]).any()
    assert set(virtual.of("phase", since).ravel()) == {Phase.NONE}
    spoilt.bad = None
    assert virtual.rests()
    # The harness has checked that every row is finite, so the bad value has not spread.
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.READY
