"""The Gaussian process agrees with that of scikit-learn."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from core.calibration.gaussian_process import JITTER, Kernel, condition, fit_kernel, matern


@pytest.fixture
def data():
    random = np.random.default_rng(5)
    points = random.uniform(-1.0, 1.0, (80, 2))
    values = np.column_stack((np.sin(3.0 * points[:, 0]), points[:, 0] * points[:, 1]))
    return points, values + 0.05 * random.standard_normal(values.shape)


def test_prediction_and_variance_from_all_points_are_those_of_scikit_learn(data):
    points, values = data
    kernel = Kernel(np.array([0.6, 1.1]), 0.02)
    judge = GaussianProcessRegressor(Matern(kernel.scales, nu=1.5), alpha=kernel.noise, optimizer=None)
    new = np.random.default_rng(6).uniform(-1.5, 1.5, (40, 2))
    mean, deviation = judge.fit(points, values).predict(new, return_std=True)
    found = condition(kernel, points, values, len(points))
    k = matern(new, found.support, kernel.scales)

    np.testing.assert_allclose(k @ found.weights, mean, atol=5e-4)
    np.testing.assert_allclose(1.0 - np.sum(k @ found.explained * k, axis=1), deviation[:, 0] ** 2, atol=1e-4)


def test_few_support_points_predict_almost_what_all_points_predict(data):
    points, values = data
    kernel = Kernel(np.array([0.6, 1.1]), 0.02)
    full, few = (condition(kernel, points, values, count) for count in (80, 40))
    new = np.random.default_rng(6).uniform(-1.0, 1.0, (40, 2))
    one, other = (matern(new, each.support, kernel.scales) @ each.weights for each in (full, few))

    assert np.abs(one - other).max() < 0.1


def test_the_fitted_scales_have_the_likelihood_that_scikit_learn_finds(data, monkeypatch):
    monkeypatch.setattr("core.calibration.gaussian_process.SCALE_SPREAD", 1e3)  # almost no prior, and no bound
    monkeypatch.setattr("core.calibration.gaussian_process.MAX_SCALE_RANGE", 1e3)
    points, values = data
    found = fit_kernel(points, values, np.array([0, 1]), np.ones(2))
    judge = GaussianProcessRegressor(
        ConstantKernel() * Matern([1.0, 1.0], nu=1.5) + WhiteKernel(), n_restarts_optimizer=3, random_state=0
    ).fit(points, values)
    best = judge.kernel_

    np.testing.assert_allclose(found.scales, best.k1.k2.length_scale, rtol=0.02)
    assert found.noise + JITTER == pytest.approx(best.k2.noise_level / best.k1.k1.constant_value, rel=0.05)
