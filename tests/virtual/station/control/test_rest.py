"""Readings of a robot that was not at rest are no reference for a tare or the start tip; the rest is repeated."""

from collections.abc import Callable

import numpy as np
import pytest

from station.config.loads import NoLoad, RampLoad
from station.control.states import RefusedError, State, Transition
from station.control.task import AVERAGE_S, LONGEST_REST_S, SETTLE_S, Phase
from tests.harness.ideal_station import BENCHES, IdealStation, Kind

REST_S = SETTLE_S + AVERAGE_S


def touched(station: IdealStation, begin: float, seconds: float, newton: float = 0.3) -> None:
    """Let a force across the tubes start `begin` [s] from now and last for `seconds`."""
    times = (0.0, begin, begin + 0.02, begin + seconds - 0.02, begin + seconds)
    station.lab.apply_load(RampLoad(times=times, magnitudes=(0.0, 0.0, newton, newton, 0.0)), station.now)


def shaken(station: IdealStation) -> None:
    """Let a force across the tubes vary between 0 and 0.05 N for 20 s."""
    times = tuple(np.arange(0.0, 20.0, 0.5).tolist())
    sizes = tuple(0.05 * (place % 2) for place in range(len(times)))
    station.lab.apply_load(RampLoad(times=times, magnitudes=sizes), station.now)


def settling(station: IdealStation) -> float:
    """Start to rest in front of a motion; return the time."""
    station.loop.start(station.holding(3.0, station.joints[-1] + np.array([0.1, 0.0, 0.0])))
    station.until(lambda: station.loop.phase is Phase.SETTLING)
    return station.now


@pytest.mark.parametrize("without", BENCHES)
@pytest.mark.parametrize("newton", [0.03, 0.3])
def test_a_touch_while_the_robot_rests_is_not_in_the_zero_of_the_force(
    without: tuple[Kind, ...], newton: float
) -> None:
    station = IdealStation(without)
    begin = settling(station)
    touched(station, SETTLE_S + 0.3, 0.8, newton)
    station.until(lambda: station.loop.phase is Phase.MOVING)
    assert station.now - begin == pytest.approx(2.0 * REST_S, abs=0.05)
    station.seconds(1.0)
    assert station.known_size < 0.01
    station.end()
    assert station.state is State.READY


def test_a_robot_that_does_not_come_to_rest_ends_the_run_with_what_changed() -> None:
    station = IdealStation()
    begin = settling(station)
    shaken(station)
    station.end()
    assert station.state is State.HOLD
    assert LONGEST_REST_S <= station.now - begin <= LONGEST_REST_S + REST_S
    assert station.loop.cause.startswith("the robot was not at rest: the force on a sensor changed by 0.0")
    assert "keep hands and loads off the robot" in station.loop.cause


def test_a_requested_tare_waits_for_a_robot_at_rest() -> None:
    station = IdealStation()
    touched(station, 0.3, 0.8)
    station.loop.tare(station.now)
    station.seconds(AVERAGE_S + 0.1)
    assert station.loop.contact.startswith("the robot was not at rest")
    station.seconds(AVERAGE_S)
    assert station.loop.contact == ""
    assert station.known_size < 1e-3


def test_a_requested_tare_of_a_robot_that_never_rests_leaves_the_zero_as_it_was() -> None:
    station = IdealStation()
    shaken(station)
    station.loop.tare(station.now)
    station.seconds(LONGEST_REST_S + AVERAGE_S)
    assert station.loop.contact.startswith("the robot was not at rest")
    station.lab.apply_load(NoLoad(), station.now)
    station.seconds(2.0)
    assert station.known_size < 1e-3


def _motion(station: IdealStation) -> None:
    station.jog("joints", (0.05, 0.0, 0.0), 0.3)


def _stop(station: IdealStation) -> None:
    station.loop.stop(station.now)
    station.loop.reset(station.now)


@pytest.mark.parametrize("interrupt", [_motion, _stop])
def test_a_confirmation_counts_for_its_own_tare_only(interrupt: Callable[[IdealStation], None]) -> None:
    station = IdealStation()
    station.loop.tare(station.now, untouched=True)
    station.seconds(0.1)
    interrupt(station)
    station.lab.apply_load(RampLoad(times=(0.0, 0.1), magnitudes=(0.0, 0.5)), station.now)
    station.loop.stop(station.now, Transition.FAULT, "a device was unplugged")
    station.loop.reset(station.now)
    station.until(lambda: station.state is State.READY)
    station.seconds(AVERAGE_S + 0.5)
    assert station.known_size == pytest.approx(0.5, abs=0.02)
    with pytest.raises(RefusedError, match="the force on the tip"):
        station.loop.start(station.holding(1.0))
