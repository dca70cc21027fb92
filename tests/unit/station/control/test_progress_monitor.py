"""When a motion is given up: on ticks made up for the purpose."""

from typing import Any, cast

import numpy as np
import pytest

from core.control.inverse import SIGMA_FLOOR
from core.control.step import Tick
from core.control.trajectories import Setpoint
from station.control.progress_monitor import FREE, PATIENCE, TOLERANCE, ProgressMonitor

FRAME = 0.025


@pytest.fixture
def limits(paper):
    return paper.limits()


class Made:
    """Anything with the given attributes."""

    def __init__(self, **attributes: Any) -> None:
        self.__dict__.update(attributes)


def tick(error: float, sigma: float = 0.01, at_bound=(0.0, 0.0, 0.0), joints=(0.0, 1.0, -0.1)) -> Tick:
    estimate = Made(observed=Made(tip=np.array([0.0, 0.0, 0.2 + error])), loaded=Made(joints=np.array(joints)))
    memory = Made(estimate=estimate, origin=np.array([0.0, 0.0, 0.2]))
    made = Made(
        memory=memory, setpoint=Setpoint(np.zeros(3), np.zeros(3)), sigma=np.array([0.02, 0.01, sigma]),
        at_bound=np.array(at_bound), at_row=np.zeros(0),
    )  # fmt: skip
    return cast(Tick, made)


def watch(limits, seconds: float, make) -> tuple[float, str]:
    """First time and words of giving up; the whole time and nothing otherwise."""
    stall = ProgressMonitor()
    for number in range(round(seconds / FRAME)):
        said = stall.look(number * FRAME, make(number * FRAME), limits)
        if said:
            return number * FRAME, said
    return seconds, ""


STUCK = SIGMA_FLOOR / 5.0


def test_a_singular_pose_that_lasts_is_given_up_after_five_seconds(limits):
    time, said = watch(limits, 20.0, lambda _: tick(2e-3, STUCK))

    assert PATIENCE == 5.0
    assert time == pytest.approx(5.0, abs=2 * FRAME)
    assert "singular pose, sigma 0.1 of 0.5 mm/s" in said
    assert "2 mm off" in said
    assert "5 s" in said
    assert "\n" not in said


def test_the_end_of_a_travel_that_lasts_is_given_up_by_name(limits):
    _, said = watch(limits, 20.0, lambda _: tick(2e-3, at_bound=(0.0, 0.0, 1.0), joints=(0.0, 1.0, -0.0051)))

    assert said.startswith("travel of inner_translation (-0.005 m): the tip is 2 mm off")


@pytest.mark.parametrize(
    "make",
    [
        lambda _: tick(TOLERANCE / 2, STUCK),  # close enough
        lambda _: tick(5e-3),  # far, but nothing in the way
        lambda _: tick(5e-3, at_bound=(1.0, 0.0, 0.0)),  # at top speed
        lambda time: tick(20e-3 * np.exp(-time / 20.0), STUCK),  # slowly nearer
        lambda time: tick(5e-3, STUCK if time % 4.0 < 3.0 else 0.01),  # in the way for 3 s at a time
        lambda time: tick(5e-3 if time % 4.0 < 3.9 else 0.0, STUCK),  # comes back again and again
    ],
)
def test_what_passes_by_itself_is_not_given_up(limits, make):
    assert watch(limits, 20.0, make)[1] == ""


def test_a_short_gap_does_not_start_the_wait_anew(limits):
    _, said = watch(limits, 20.0, lambda time: tick(5e-3, STUCK if time % 1.0 > FREE / 2 else 0.01))

    assert said
