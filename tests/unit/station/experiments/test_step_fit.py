"""Fits of synthetic step responses."""

import numpy as np
import pytest

from station.experiments.step_fit import fit_step, fold

TIMES = np.arange(0.0, 6.0, 0.002)


@pytest.mark.parametrize("rate", [1.0, 2.5, 5.0])
@pytest.mark.parametrize("dead_time", [0.0, 0.03, 0.2])
def test_the_step_fit_recovers_rate_and_dead_time_of_a_noisy_response(rate, dead_time):
    noise = np.random.default_rng(1).normal(scale=0.05, size=TIMES.size)
    response = np.where(dead_time < TIMES, 1.0 - np.exp(-rate * (TIMES - dead_time)), 0.0)

    exact, noisy = fit_step(TIMES, response), fit_step(TIMES, response + noise)

    assert exact == pytest.approx((rate, dead_time), abs=1e-3)
    assert noisy.rate == pytest.approx(rate, rel=0.03)
    assert noisy.dead_time == pytest.approx(dead_time, abs=0.02)


def test_fold_averages_a_square_wave_into_one_step():
    there = 1.0 - np.exp(-2.0 * TIMES)
    times = np.arange(0.0, 4 * 6.0 + 1.0, 0.002)
    response = np.r_[there, 1.0 - there, there, 1.0 - there, np.zeros(500)]  # one incomplete stay at the end

    folded_times, folded = fold(times, response, 6.0)

    np.testing.assert_allclose(folded_times, TIMES, atol=1e-9)
    np.testing.assert_allclose(folded, there, atol=1e-12)
