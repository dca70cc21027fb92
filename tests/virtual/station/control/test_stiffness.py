"""Stiffness of the tip in the virtual lab: along the axes of the tip, and changed while a motion runs."""

from dataclasses import replace

import numpy as np
import pytest

from core.control.stiffness import MAX_SPEED_M_S, RAMP_S
from core.errors import DescriptionError
from station.config.controllers import PERIOD_S
from station.config.loads import RampLoad
from station.config.motions import HoldMotion
from station.control.states import RefusedError
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation, usual_case

#: Forces across the tip, and along it, where the tubes are 15 times stiffer.
FORCE_N, AXIAL_FORCE_N = 0.15, 0.4


@pytest.fixture
def holding() -> VirtualStation:
    """A motion that holds the tip with 32 N/m along x and y, and 294 N/m along z."""
    return VirtualStation(a_case("stiffness", "natural-x")).moving(HoldMotion(), duration=600.0)


def push(virtual: VirtualStation, direction: tuple[float, float, float], force: float = FORCE_N) -> None:
    """Apply a force [N] that rises within 1 s and stays."""
    virtual.lab.apply_load(RampLoad(times=(0.0, 1.0), magnitudes=(0.0, force), direction=direction), virtual.now)


def displacement(virtual: VirtualStation, start: int) -> np.ndarray:
    """Return the displacement (3,) of the true tip from row `start` to the mean of the last 2 s [m]."""
    tip = virtual.of("tip_true")
    return tip[-round(2.0 / PERIOD_S) :].mean(axis=0) - tip[start - 1]


def test_tip_pushed_along_its_axis_has_the_desired_stiffness() -> None:
    """Along the axes of the world, these values would let the tip give way 2.5 times as far."""
    case, desired = a_case("stiffness", "natural-x"), (60.0, 40.0, 300.0)
    assert case.controller.stiffness is not None
    stiffness = replace(case.controller.stiffness, axes=desired, frame="tip")
    virtual = VirtualStation(case._replace(controller=replace(case.controller, stiffness=stiffness)))
    virtual.moving(HoldMotion())
    start, axis = len(virtual.rows), virtual.lab.truth.direction
    assert axis is not None
    x, y, z = axis.tolist()
    push(virtual, (x, y, z), AXIAL_FORCE_N)
    virtual.seconds(15.0)

    along = displacement(virtual, start) @ axis
    assert pytest.approx(desired[2], rel=0.1) == AXIAL_FORCE_N / along


def test_tip_reaches_a_changed_stiffness_without_a_jump(holding: VirtualStation) -> None:
    start = len(holding.rows)
    push(holding, (1.0, 0.0, 0.0))
    holding.seconds(12.0)
    assert pytest.approx(32.0, rel=0.1) == FORCE_N / displacement(holding, start)[0]

    changed = len(holding.rows)
    holding.loop.set_stiffness(holding.now, (80.0, 32.0, 294.0))
    holding.seconds(12.0)

    assert pytest.approx(80.0, rel=0.1) == FORCE_N / displacement(holding, start)[0]
    compliance = 1.0 / holding.of("stiffness")[changed - 1 :, 0]
    assert np.diff(compliance).min() == pytest.approx((1 / 80 - 1 / 32) * PERIOD_S / RAMP_S, rel=0.01)
    assert (compliance[round(RAMP_S / PERIOD_S) + 2 :] == 1.0 / 80.0).all()
    steps = np.linalg.norm(np.diff(holding.of("tip_desired")[changed - 1 :], axis=0), axis=1)
    assert steps.max() < 0.5 * MAX_SPEED_M_S * PERIOD_S


def test_change_during_a_change_continues_from_the_present_stiffness(holding: VirtualStation) -> None:
    holding.loop.set_stiffness(holding.now, (80.0, 32.0, 294.0))
    holding.seconds(0.5 * RAMP_S)
    holding.loop.set_stiffness(holding.now, (32.0, 32.0, 294.0))
    before = holding.of("stiffness")[-1, 0]
    holding.tick()
    assert 32.0 < before < 80.0
    assert holding.of("stiffness")[-1, 0] == pytest.approx(before, rel=0.01)
    holding.seconds(RAMP_S)
    assert holding.of("stiffness")[-1].tolist() == [32.0, 32.0, 294.0]


def test_stiffness_that_contact_does_not_allow_is_refused_while_a_motion_runs(holding: VirtualStation) -> None:
    with pytest.raises(DescriptionError, match="multiply the stiffness by"):
        holding.loop.set_stiffness(holding.now, (1.0, 1.0, 1.0))
    holding.seconds(RAMP_S)
    assert holding.of("stiffness")[-1].tolist() == [32.0, 32.0, 294.0]


def test_changed_stiffness_ends_with_its_motion(holding: VirtualStation) -> None:
    holding.loop.set_stiffness(holding.now, (80.0, 80.0, 500.0))
    holding.seconds(RAMP_S)
    holding.loop.stop(holding.now)
    holding.loop.reset(holding.now)
    with pytest.raises(RefusedError, match="only while a motion runs"):
        holding.loop.set_stiffness(holding.now, (80.0, 80.0, 500.0))
    holding.moving(HoldMotion())
    assert holding.of("stiffness")[-1].tolist() == [32.0, 32.0, 294.0]


def test_stiffness_of_a_motion_without_one_cannot_be_changed() -> None:
    virtual = VirtualStation(usual_case()).moving(HoldMotion(), since=0.1)
    with pytest.raises(RefusedError, match="was started with 'stiffness'"):
        virtual.loop.set_stiffness(virtual.now, (80.0, 80.0, 500.0))
    assert not virtual.of("stiffness").any()
