"""Least squares against closed forms: values, intervals, and undetermined combinations."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pytest

from core.calibration.fit import Parameter, fit
from core.errors import NoSolution


@dataclass
class Line:
    """Residuals of A x = b in standard deviations."""

    matrix: np.ndarray
    measured: np.ndarray

    def residuals(self, values):
        return self.matrix @ values - self.measured

    def jacobian(self, values):
        return self.matrix


def test_a_linear_fit_has_the_solution_of_the_normal_equations():
    random = np.random.default_rng(0)
    matrix, truth = 100.0 * random.normal(size=(40, 3)), np.array([0.5, -1.0, 2.0])
    measured = matrix @ truth + random.normal(size=40)

    found = fit(Line(matrix, measured), [Parameter(name, "", 1.0) for name in "abc"])

    expected, rest, *_ = np.linalg.lstsq(matrix, measured)
    factor = max(1.0, float(rest[0]) / 37)
    np.testing.assert_allclose(found.values, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.covariance, factor * np.linalg.inv(matrix.T @ matrix), rtol=1e-9)
    assert found.interval("b") == pytest.approx(1.959964 * math.sqrt(found.covariance[1, 1]))
    assert found.weak == ()


def test_95_percent_of_the_fits_confidence_intervals_contain_the_true_value():
    random, inside = np.random.default_rng(1), 0
    matrix, truth = 30.0 * random.normal(size=(25, 2)), np.array([0.1, -0.3])
    for _ in range(150):
        found = fit(Line(matrix, matrix @ truth + random.normal(size=25)), [Parameter(n, "", 1.0) for n in "ab"])
        inside += abs(found.value("a") - truth[0]) <= found.interval("a")
    assert 0.9 < inside / 150 < 1.0


def test_a_sum_of_fit_parameters_is_determined_although_its_parts_are_not():
    matrix = np.tile([10.0, 10.0, 0.0], (5, 1)) + np.outer(np.arange(5), [0.0, 0.0, 10.0])

    found = fit(
        Line(matrix, matrix @ [1.0, 2.0, 3.0]),
        [Parameter("a", "m", 1.0, prior=2.0), Parameter("b", "m", 1.0, prior=2.0), Parameter("c", "m", 1.0)],
    )

    (weak,) = found.weak
    assert dict(weak.parts) == {"a": pytest.approx(math.sqrt(0.5)), "b": pytest.approx(-math.sqrt(0.5))}
    assert weak.fixed_by_prior
    assert found.value("a") + found.value("b") == pytest.approx(3.0, abs=1e-2)
    assert found.value("c") == pytest.approx(3.0, abs=1e-2)


def test_fewer_data_than_parameters_leave_combinations_undetermined():
    found = fit(Line(np.array([[5.0, 0.0]]), np.array([5.0])), [Parameter("a", "", 1.0), Parameter("b", "", 1.0)])

    (weak,) = found.weak
    assert weak.parts == (("b", 1.0),)
    assert math.isinf(weak.open)
    assert "undetermined" in str(weak)


def test_residuals_larger_than_the_noise_widen_the_intervals():
    random = np.random.default_rng(2)
    matrix = 100.0 * random.normal(size=(50, 1))
    quiet, loud = (
        fit(Line(matrix, matrix[:, 0] + size * random.normal(size=50)), [Parameter("a", "", 1.0)])
        for size in (1.0, 7.0)
    )
    assert 5.0 < loud.interval("a") / quiet.interval("a") < 10.0


def test_a_fit_stays_inside_the_bounds_of_its_parameters():
    found = fit(Line(np.eye(1), np.array([2.0])), [Parameter("a", "", 1.0, bounds=(-0.5, 0.5))])

    assert found.value("a") == pytest.approx(0.5)


@dataclass
class Cliff:
    """Residuals of log(1 - x) = b, which do not exist for x >= 1: the first Gauss-Newton step ends at such an x."""

    target: float

    def residuals(self, values):
        if values[0] >= 1.0:
            raise NoSolution("no shape")
        return np.array([math.log(1.0 - values[0]) - self.target])

    def jacobian(self, values):
        return np.array([[-1.0 / (1.0 - values[0])]])


def test_a_fit_step_to_parameters_without_a_shape_is_shortened():
    found = fit(Cliff(-3.0), [Parameter("a", "", 1.0)])
    assert found.value("a") == pytest.approx(1.0 - math.exp(-3.0), abs=1e-6)


def test_a_fit_that_starts_without_a_shape_raises_no_solution():
    with pytest.raises(NoSolution, match="no shape"):
        fit(Cliff(-3.0), [Parameter("a", "", 1.0)], np.array([2.0]))


def test_intervals_include_errors_of_the_model_that_explain_the_residuals():
    """The model omits a slope of unknown size: an offset fitted to points on one side of zero is wrong by it."""
    at, slope, noise = np.linspace(0.5, 1.5, 50), 30.0, np.random.default_rng(2).standard_normal(50)
    measured = 4.0 + slope * at + noise

    class Offset:
        def residuals(self, values):
            return values[0] - measured

        def jacobian(self, values):
            return np.ones((50, 1))

    found = fit(Offset(), (Parameter("offset", "m", 1.0),))
    wide = found.with_model_errors(-at[:, None], np.array([0.1]))

    assert abs(found.values[0] - 4.0) > 10.0 * found.interval("offset")
    # The mean of the residuals' positions is 1, so that the offset contains the whole slope.
    assert wide.errors[0] == pytest.approx(slope, rel=0.1)
    assert abs(found.values[0] - 4.0) < wide.interval("offset")
    exact = dataclasses.replace(found, residuals=noise)
    assert exact.with_model_errors(-at[:, None], np.array([0.1])).errors == pytest.approx(exact.errors, rel=0.2)
