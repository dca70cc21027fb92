"""NaN or infinity anywhere in the loop: nothing is sent, a controlled stop, the last second is kept."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from station.config.controllers import PERIOD
from station.control.states import State
from station.control.task import Phase
from station.devices.interfaces import Devices
from tests.harness.virtual_station import VirtualStation


class Spoilt:
    """A driver whose numbers are `bad` from some moment on."""

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


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("device", "named"), [("stages", "stages: "), ("tracker", "tracker: "), ("sensors", "force sensors: ")]
)
def test_nothing_is_sent_and_every_axis_stops(virtual: VirtualStation, device: str, named: str, bad: float) -> None:
    spoilt = Spoilt(getattr(virtual.devices, device))
    devices: Devices = replace(virtual.devices, **{device: spoilt})
    virtual.loop.devices = devices
    virtual.moving()
    begin = len(virtual.rows)
    spoilt.bad = bad
    took = virtual.becomes(State.HOLD)

    assert took <= (0.025 if device == "tracker" else 0.0) + 2 * PERIOD
    assert named in virtual.loop.cause
    assert str(bad).removeprefix("-") in virtual.loop.cause
    assert "\n" not in virtual.loop.cause
    virtual.seconds(0.4)
    since = virtual.rows[begin + round(took / PERIOD) :]
    assert not virtual.of("velocity_commanded", since).any()
    # estimates that stand are told from those that are new
    assert virtual.of("held", since).all() == (device != "tracker")
    assert not virtual.of("held", virtual.rows[:begin]).any()
    assert set(virtual.of("phase", since).ravel()) == {Phase.NONE}
    spoilt.bad = None
    assert virtual.rests()
    # every row since is finite (looked at when it was made), so nothing of it has spread
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.READY


def test_a_command_that_is_not_finite_is_not_sent_by_the_driver_either(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.devices.stages.command(np.array([0.1, np.nan, 0.0]), virtual.now)
    virtual.loop.stop(virtual.now)
    virtual.seconds(0.4)

    assert virtual.rests()
