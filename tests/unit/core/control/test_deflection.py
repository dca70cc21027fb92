import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_discrete_are

from core.control.deflection import RateFilter
from core.errors import DescriptionError, NotFinite

PERIOD = 0.002


def noise(period: float, bandwidth: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix and process noise of a constant-velocity model; its measurement noise is 1."""
    density = (2.0 * math.pi * bandwidth) ** 4 * period
    shaken = np.array([[period**3 / 3.0, period**2 / 2.0], [period**2 / 2.0, period]])
    return np.array([[1.0, period], [0.0, 1.0]]), density * shaken


def test_steady_rate_filter_equals_the_full_kalman_recursion_once_settled():
    random, axes, start = np.random.default_rng(31), 3, np.array([1e-3, -2e-3, 0.0])
    recursions = []
    for axis in range(axes):
        kalman = KalmanFilter(dim_x=2, dim_z=1)
        kalman.F, kalman.Q = noise(PERIOD, 2.0)
        kalman.H, kalman.P = np.array([[1.0, 0.0]]), np.diag([1.0, 100.0])
        kalman.x = np.array([[start[axis]], [0.0]])
        recursions.append(kalman)
    steady = RateFilter(PERIOD, 2.0)
    estimate = steady.start(start)

    for tick in range(2000):
        measured = 0.01 * np.sin(2.0 * tick * PERIOD + np.arange(3)) + random.normal(scale=1e-4, size=3)
        estimate = steady.update(estimate, measured)
        for kalman, value in zip(recursions, measured, strict=True):
            kalman.predict()
            kalman.update(value)

    full = np.array([kalman.x[:, 0] for kalman in recursions])
    assert np.abs(full[:, 1]).max() > 1e-3  # the test case has a rate that is not zero
    np.testing.assert_allclose(estimate.value, full[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.rate, full[:, 1], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("period", "bandwidth"), [(0.002, 0.1), (0.002, 1.0), (0.002, 100.0), (0.025, 1.0)])
def test_the_rate_filters_gain_solves_the_riccati_equation(period, bandwidth):
    transition, process = noise(period, bandwidth)
    observe = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(transition.T, observe.T, process, np.eye(1))
    expected = covariance[:, 0] / (covariance[0, 0] + 1.0)

    np.testing.assert_allclose(RateFilter(period, bandwidth).gain, expected, rtol=1e-6)


@pytest.mark.parametrize("bandwidth", [0.5, 1.0, 5.0])
def test_the_rate_filters_bandwidth_is_its_natural_frequency(bandwidth):
    """The natural frequency w follows from the response to a unit innovation: w^2 = rate gain / period."""
    steady = RateFilter(PERIOD, bandwidth)
    rate = steady.update(steady.start(np.zeros(3)), np.ones(3)).rate[0]

    assert math.sqrt(rate / PERIOD) == pytest.approx(2.0 * math.pi * bandwidth, rel=0.03)


def test_rate_filter_follows_a_ramp_without_error_once_settled():
    slope, steady = np.array([0.01, -0.02, 0.0]), RateFilter(PERIOD)
    estimate = steady.start(np.zeros(3))

    for tick in range(1, 5001):
        estimate = steady.update(estimate, slope * (tick * PERIOD))

    np.testing.assert_allclose(estimate.rate, slope, rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.value, slope * 10.0, rtol=0, atol=1e-10)


def test_rate_filter_starts_at_rest_and_stays_at_rest_for_a_constant_input():
    steady, here = RateFilter(PERIOD), np.array([1.0, 2.0, 3.0])

    estimate = steady.update(steady.start(here), here)

    assert estimate.value.tolist() == [1.0, 2.0, 3.0]
    assert estimate.rate.tolist() == [0.0, 0.0, 0.0]


def test_rate_filter_extrapolates_at_the_last_rate_without_a_measurement():
    steady = RateFilter(PERIOD)
    moving = steady.update(steady.start(np.zeros(3)), np.array([1e-3, 0.0, -1e-3]))

    coasted = moving
    for _ in range(10):
        coasted = steady.update(coasted, None)

    np.testing.assert_array_equal(coasted.rate, moving.rate)
    np.testing.assert_allclose(coasted.value, moving.value + 10 * PERIOD * moving.rate, rtol=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_rate_filter_refuses_a_measurement_that_is_not_finite(bad):
    steady = RateFilter(PERIOD)

    with pytest.raises(NotFinite, match=rf"deflection .*{bad}.* m is not finite"):
        steady.update(steady.start(np.zeros(3)), np.array([0.0, bad, 0.0]))
    with pytest.raises(NotFinite, match=rf"deflection .*{bad}.* m is not finite"):
        steady.start(np.array([0.0, bad, 0.0]))


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, 250.0, math.nan, math.inf])
def test_rate_filter_refuses_a_bandwidth_outside_zero_to_nyquist(bandwidth):
    with pytest.raises(DescriptionError, match=rf"bandwidth {bandwidth:g} Hz is outside 0 \.\.\. 250 Hz"):
        RateFilter(PERIOD, bandwidth)


@pytest.mark.parametrize("period", [0.0, -0.002, math.nan, math.inf])
def test_rate_filter_refuses_an_invalid_period(period):
    with pytest.raises(DescriptionError, match=rf"period {period:g} s must be finite and greater than 0"):
        RateFilter(period)
