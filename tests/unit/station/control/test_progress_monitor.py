"""The progress monitor, which ends stalled or overloaded motions, on synthetic ticks."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from core.control.force_fusion import FusedLoad
from core.control.step import Tick
from core.control.trajectories import Setpoint
from core.control.velocity_ik import SIGMA_FLOOR_M_S
from station.control.progress_monitor import (
    MIN_ERROR_M,
    OVERLOAD_TIME_S,
    STALL_TIME_S,
    UNBLOCKED_TIME_S,
    ProgressMonitor,
)

FRAME = 0.025


@pytest.fixture
def limits(paper):
    return paper.limits()


def tick(error: float, sigma: float = 0.01, at_bound=(0.0, 0.0, 0.0), joints=(0.0, 1.0, -0.1), force=0.0) -> Tick:
    estimate = SimpleNamespace(
        observed=SimpleNamespace(tip=np.array([0.0, 0.0, 0.2 + error])), loaded=SimpleNamespace(joints=np.array(joints))
    )
    memory = SimpleNamespace(estimate=estimate, origin=np.array([0.0, 0.0, 0.2]))
    made = SimpleNamespace(
        memory=memory, setpoint=Setpoint(np.zeros(3), np.zeros(3)), sigma=np.array([0.02, 0.01, sigma]),
        at_bound=np.array(at_bound), at_row=np.zeros(0), load=FusedLoad(np.array([force, 0.0, 0.0]), np.zeros(3)),
    )  # fmt: skip
    return cast(Tick, made)


def watch(limits, seconds: float, make) -> tuple[float, str]:
    """Return time [s] and text when the monitor ends the motion, or `seconds` and no text if it never does."""
    stall = ProgressMonitor()
    for number in range(round(seconds / FRAME)):
        text = stall.check(number * FRAME, make(number * FRAME), limits)
        if text:
            return number * FRAME, text
    return seconds, ""


STUCK = SIGMA_FLOOR_M_S / 5.0


def test_singular_pose_that_lasts_five_seconds_ends_the_motion(limits):
    time, text = watch(limits, 20.0, lambda _: tick(2e-3, STUCK))

    assert STALL_TIME_S == 5.0
    assert time == pytest.approx(5.0, abs=2 * FRAME)
    assert "singular pose, sigma 0.1 of 0.5 mm/s" in text
    assert "2 mm off" in text
    assert "5 s" in text
    assert "\n" not in text


def test_joint_that_stays_at_its_end_of_travel_ends_the_motion_and_is_named(limits):
    _, text = watch(limits, 20.0, lambda _: tick(2e-3, at_bound=(0.0, 0.0, 1.0), joints=(0.0, 1.0, -0.0051)))

    assert text.startswith("travel of inner_translation (-0.005 m): the tip is 2 mm off")


@pytest.mark.parametrize(
    "make",
    [
        lambda _: tick(MIN_ERROR_M / 2, STUCK),  # the tip is close enough to its setpoint
        lambda _: tick(5e-3),  # the tip is far away, but no limit is active
        lambda _: tick(5e-3, at_bound=(1.0, 0.0, 0.0)),  # a joint is at its top speed
        lambda time: tick(20e-3 * np.exp(-time / 20.0), STUCK),  # the tip slowly comes nearer
        lambda time: tick(5e-3, STUCK if time % 4.0 < 3.0 else 0.01),  # the pose is singular for only 3 s at a time
        lambda time: tick(5e-3 if time % 4.0 < 3.9 else 0.0, STUCK),  # the tip returns to its setpoint again and again
    ],
)
def test_temporary_stall_does_not_end_a_motion(limits, make):
    assert watch(limits, 20.0, make)[1] == ""


def test_short_time_without_an_active_limit_does_not_restart_the_stall_time(limits):
    _, text = watch(limits, 20.0, lambda time: tick(5e-3, STUCK if time % 1.0 > UNBLOCKED_TIME_S / 2 else 0.01))

    assert text


def test_tip_force_above_the_strength_of_tubes_and_sensors_ends_the_motion(limits):
    time, text = watch(limits, 2.0, lambda now: tick(0.0, force=-1.2 if now >= 1.0 - 1e-9 else 0.0))

    assert time == pytest.approx(1.0 + OVERLOAD_TIME_S, abs=2 * FRAME)
    assert "force on the tip 1.2 N is above 0.94 N" in text
    assert "the moment range of a base sensor" in text


def test_short_overload_and_a_tip_force_below_the_bound_do_not_end_the_motion(limits):
    short = 0.5 * OVERLOAD_TIME_S

    assert watch(limits, 5.0, lambda now: tick(0.0, force=2.0 if now % 0.5 < short else 0.0))[1] == ""
    assert watch(limits, 5.0, lambda _: tick(0.0, force=0.9))[1] == ""
