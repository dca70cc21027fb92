"""Estimators over minutes, many phases and many target motions."""

import math

import numpy as np
import pytest

from core.control.predictor import Waves
from tests.unit.core.control.test_estimation import smoothing_distances
from tests.unit.core.control.test_predictor import NOISE, predicted, target


@pytest.mark.parametrize("phase", [0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi])
def test_smoothed_force_stays_near_the_force_for_minutes(phase: float) -> None:
    first, second = smoothing_distances(phase, 300.0)
    assert 0.0 < first < 0.3
    assert second < 1.02 * first


@pytest.mark.parametrize("rate", [0.15, 0.2, 0.25, 0.33, 0.42])
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_predictor_finds_the_rates_and_predicts_within_the_frames_noise(rate: float, seed: int) -> None:
    times, errors, known = predicted(Waves(), target(rate, seed), seed=seed)
    assert Waves().rates(known)[0] == pytest.approx(rate, rel=0.08)
    assert np.sqrt(np.mean(errors[times > 15.0] ** 2)) < math.sqrt(3.0) * NOISE
