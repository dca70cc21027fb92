"""Axis signs and the tracker's latency, from simulated motions with known values."""

import math

import numpy as np
import pytest

from core.calibration.commissioning import find_latency, find_signs
from core.calibration.fit import UnobservableCombination
from core.model.statics import Statics
from tests.harness.visited import TRACKER, altered, seen

START = np.array([0.3, 1.5, -0.08])
MOVES = np.vstack([sign * np.diag([0.3, 0.3, 0.012])[k] for k in range(3) for sign in (-1.0, 1.0)])


@pytest.mark.parametrize("truth", [(1.0, 1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0)])
def test_the_signs_of_all_axes_are_found_without_a_registration(paper_robot, truth):
    """In this test the simulated real tubes also differ from the robot file's values."""
    measurements = [
        measurement._replace(joints=START + move)
        for measurement, move in zip(seen(altered(paper_robot), START + truth * MOVES), MOVES, strict=True)
    ]

    found = find_signs(paper_robot, START, measurements)

    assert found.signs.tolist() == list(truth)
    assert found.next_rms > 3.0 * found.rms


def test_moves_too_small_for_finding_signs_are_refused(paper_robot):
    measurements = [
        measurement._replace(joints=START + 0.002 * move)
        for measurement, move in zip(seen(paper_robot, START + 0.002 * MOVES), MOVES, strict=True)
    ]

    with pytest.raises(UnobservableCombination, match="make larger moves"):
        find_signs(paper_robot, START, measurements)


def motion(model: Statics, speed: float) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, 6.0, 0.002)
    swing = np.stack(
        (0.3 * np.sin(3.0 * speed * times), 0.2 * np.sin(2.0 * speed * times), 0.01 * np.sin(speed * times)), axis=1
    )
    near, tips = None, []
    for joints in START + swing:
        near = model.solve(joints, np.zeros(6), near)
        tips.append(near.tip.copy())
    return times, np.array(tips)


@pytest.mark.parametrize("latency", [0.0, 0.024])
def test_the_tracker_latency_is_found_from_a_known_motion(paper_robot, latency):
    times, tips = motion(Statics(paper_robot), 1.0)
    arrivals = np.arange(0.5, 5.5, 0.025)
    position = np.stack([np.interp(arrivals - latency, times, column) for column in tips.T], axis=1)
    noise = 0.1e-3 * np.random.default_rng(5).standard_normal(position.shape)

    found = find_latency(times, tips, arrivals, TRACKER.inverse().apply(position + noise))

    assert found.latency == pytest.approx(latency, abs=1e-3)
    assert abs(found.latency - latency) < 4.0 * found.error
    assert found.rms == pytest.approx(math.sqrt(3.0) * 0.1e-3, rel=0.15)


def test_a_motion_too_slow_for_finding_the_latency_is_refused(paper_robot):
    times, tips = motion(Statics(paper_robot), 0.002)
    arrivals = np.arange(0.5, 5.5, 0.025)
    position = np.stack([np.interp(arrivals, times, column) for column in tips.T], axis=1)
    noise = 0.1e-3 * np.random.default_rng(6).standard_normal(position.shape)

    with pytest.raises(UnobservableCombination, match="move faster"):
        find_latency(times, tips, arrivals, position + noise)
