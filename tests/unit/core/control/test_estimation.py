"""Estimate of a tick: the smoothed force follows the force also while the filter's bandwidth changes."""

import math

import numpy as np
import pytest

from core.control.actuation import Actuation
from core.control.deflection import RateFilter
from core.control.estimation import Estimate, Estimator, estimate
from core.control.observer import Observer
from core.control.tip_force import BANDWIDTH, FORCE, QUALITY, LoadEstimator
from core.model.solution import pure_force
from core.model.statics import Statics
from station.config.robots import load_robot

PERIOD_S = 0.002


@pytest.mark.parametrize("phase", [0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi])
def test_smoothed_force_stays_near_the_force_while_bandwidth_and_force_change_in_step(phase: float) -> None:
    statics = Statics(load_robot("paper").robot())
    free = statics.solve(np.array([0.0, 0.5 * math.pi, -0.1]), np.zeros(6))
    loaded = statics.solve(free.joints, pure_force(np.array([0.05, 0.0, 0.0])), free)
    estimator = Estimator(
        RateFilter(PERIOD_S), Observer(PERIOD_S), Actuation(PERIOD_S), LoadEstimator(moments=True, adapts=True)
    )
    now = estimator.start(loaded, free, np.array([0.05, 0.0, 0.0]), loaded.tip)
    period, distances = 2.0, []
    for tick in range(round(300.0 / PERIOD_S)):
        angle = 2.0 * math.pi * tick * PERIOD_S / period
        force = np.array([0.05 + 0.02 * math.sin(angle), 0.0, 0.0])
        numbers = now.numbers.copy()
        last, now = now, Estimate(loaded, free, numbers)
        now.known.load[FORCE] = force
        now.known.load[QUALITY, BANDWIDTH] = 1.0 + 0.5 * math.sin(angle + phase)
        estimate(
            estimator.settings, loaded.numbers, free.numbers, loaded.numbers, free.numbers, last.numbers,
            force, np.zeros(3), np.zeros(3), -1.0, numbers,
        )  # fmt: skip
        distances.append(float(np.linalg.norm(now.known.force_smooth - now.known.force_filtered)))
    np.testing.assert_array_equal(now.force, now.known.load[FORCE])
    first, second = np.array_split(distances, 2)
    assert 0.0 < first.max() < 0.3
    assert second.max() < 1.02 * first.max()
