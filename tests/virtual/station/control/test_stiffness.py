"""Stiffness of the tip in the virtual lab, changed while a motion runs."""

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

FORCE_N = 0.15


@pytest.fixture
def holding() -> VirtualStation:
    """A motion that holds the tip with 32 N/m along x and y, and 294 N/m along z."""
    return VirtualStation(a_case("stiffness", "natural-x")).moving(HoldMotion(), duration=600.0)


def displacement(virtual: VirtualStation, start: int) -> np.ndarray:
    """Return the displacement (3,) of the true tip from row `start` to the mean of the last 2 s [m]."""
    tip = virtual.of("tip_true")
    return tip[-round(2.0 / PERIOD_S) :].mean(axis=0) - tip[start - 1]


def test_tip_reaches_a_changed_stiffness_without_a_jump(holding: VirtualStation) -> None:
    start = len(holding.rows)
    holding.lab.apply_load(RampLoad(times=(0.0, 1.0), magnitudes=(0.0, FORCE_N)), holding.now)
    holding.seconds(8.0)
    assert pytest.approx(32.0, rel=0.1) == FORCE_N / displacement(holding, start)[0]

    changed = len(holding.rows)
    holding.loop.set_stiffness(holding.now, (80.0, 32.0, 294.0))
    holding.seconds(8.0)

    assert pytest.approx(80.0, rel=0.1) == FORCE_N / displacement(holding, start)[0]
    compliance = 1.0 / holding.of("stiffness")[changed - 1 :, 0]
    assert np.diff(compliance).min() == pytest.approx((1 / 80 - 1 / 32) * PERIOD_S / RAMP_S, rel=0.01)
    assert (compliance[round(RAMP_S / PERIOD_S) + 2 :] == 1.0 / 80.0).all()
    steps = np.linalg.norm(np.diff(holding.of("tip_desired")[changed - 1 :], axis=0), axis=1)
    assert steps.max() < 0.5 * MAX_SPEED_M_S * PERIOD_S


def test_changes_continue_from_the_present_stiffness_keep_their_bound_and_end_with_the_motion(
    holding: VirtualStation,
) -> None:
    holding.loop.set_stiffness(holding.now, (80.0, 32.0, 294.0))
    holding.seconds(0.5 * RAMP_S)
    holding.loop.set_stiffness(holding.now, (32.0, 32.0, 294.0))
    before = holding.of("stiffness")[-1, 0]
    holding.tick()
    assert 32.0 < before < 80.0
    assert holding.of("stiffness")[-1, 0] == pytest.approx(before, rel=0.01)
    with pytest.raises(DescriptionError, match="multiply the stiffness by"):
        holding.loop.set_stiffness(holding.now, (1.0, 1.0, 1.0))
    holding.seconds(RAMP_S)
    assert holding.of("stiffness")[-1].tolist() == [32.0, 32.0, 294.0]

    holding.loop.set_stiffness(holding.now, (80.0, 80.0, 500.0))
    holding.seconds(0.1)
    holding.loop.stop(holding.now)
    holding.loop.reset(holding.now)
    with pytest.raises(RefusedError, match="only while a motion runs"):
        holding.loop.set_stiffness(holding.now, (80.0, 80.0, 500.0))
    holding.moving(HoldMotion(), since=0.1)
    assert holding.of("stiffness")[-1].tolist() == [32.0, 32.0, 294.0]


def test_stiffness_of_a_motion_without_one_cannot_be_changed() -> None:
    virtual = VirtualStation(usual_case()).moving(HoldMotion(), since=0.1)
    with pytest.raises(RefusedError, match="was started with 'stiffness'"):
        virtual.loop.set_stiffness(virtual.now, (80.0, 80.0, 500.0))
    assert not virtual.of("stiffness").any()
