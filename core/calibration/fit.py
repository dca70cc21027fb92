"""Least-squares fit with confidence intervals and a list of parameter combinations that the data do not determine.

Every parameter has a tolerance (`size`): the largest error that does not matter. Prior knowledge (for example a tube's
length to a millimetre) adds one row per parameter to the least-squares problem. The test whether the data determine a
parameter combination uses the data alone, in units of the tolerances. A value that only the prior determines is
therefore never reported as measured.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from core.errors import CtrError, NoSolution, PoseError
from core.robot.robot import Array

#: The data determine a parameter combination if its standard deviation is below this fraction of its tolerance.
MAX_OPEN_SHARE = 0.5
#: Two-sided 95 % quantile of the normal distribution, for confidence intervals.
NORMAL_QUANTILE_95 = 1.959964

#: Largest number of steps of a fit.
MAX_STEPS = 60


class UnobservableCombination(CtrError):
    """The data cannot determine the requested parameters; the text states what is missing."""


class Parameter(NamedTuple):
    """One unknown of a fit, as a deviation from its start value."""

    name: str
    unit: str
    size: float  #: tolerance: largest error that does not matter, in `unit`
    prior: float = math.inf  #: standard deviation of the prior, whose mean is 0, in `unit`; inf: no prior
    bounds: tuple[float, float] = (-math.inf, math.inf)


class Combination(NamedTuple):
    """A direction in the space of the parameters that the data do not determine."""

    parts: tuple[tuple[str, float], ...]  #: parameters and their shares, in tolerances, largest first
    open: float  #: standard deviation that the data alone leave, in tolerances; inf: not observable
    fixed_by_prior: bool  #: whether priors determine the combination

    def __str__(self) -> str:
        """Return human-readable text."""
        shares = " ".join(f"{share:+.2f} {name}" for name, share in self.parts)
        return f"{shares} ({'determined by the prior' if self.fixed_by_prior else 'undetermined'})"


class FitProblem(Protocol):
    """A least-squares problem; every residual is in units of its standard deviation."""

    def residuals(self, values: Array) -> Array:
        """Return the residuals (m,) at parameters (p,)."""
        ...

    def jacobian(self, values: Array) -> Array:
        """Return the derivative of the residuals by the parameters (m, p)."""
        ...


@dataclass(frozen=True)
class Fit:
    """Result of a least-squares fit."""

    parameters: tuple[Parameter, ...]
    values: Array  #: (p,) fitted values of the parameters
    residuals: Array  #: (m,) residuals of the data, in standard deviations
    jacobian: Array  #: (m, p) derivative of the residuals by the parameters at the solution
    #: (p, p) covariance of the parameters from errors of the model, which explain the residuals beyond the noise; None:
    #: larger residuals count as larger noise
    systematic: Array | None = None

    @cached_property
    def variance_factor(self) -> float:
        """Chi square over degrees of freedom: 1 when the residuals match the noise."""
        return float(self.residuals @ self.residuals) / max(self.residuals.size - self.values.size, 1)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters (p, p), from data and priors; larger if the residuals exceed the noise."""
        excess = max(self.variance_factor, 1.0) if self.systematic is None else 1.0
        size = np.array([p.size for p in self.parameters])
        scaled = self.jacobian * size
        prior = np.diag([(p.size / p.prior) ** 2 for p in self.parameters])
        information = scaled.T @ scaled / excess + prior
        inverse: Array = np.asarray(np.linalg.pinv(information, rcond=1e-14, hermitian=True), dtype=np.float64)
        noise = inverse * np.outer(size, size)
        return noise if self.systematic is None else noise + self.systematic

    def with_model_errors(self, sensitivity: Array, sizes: Array) -> "Fit":
        """Return the fit with covariances for errors of k model parameters that were not fitted.

        Args:
            sensitivity: derivative of the residuals by the k parameters (m, k).
            sizes: expected errors of the k parameters (k,); the residuals beyond the noise set their common scale.

        """
        if self.variance_factor <= 1.0:
            return self
        rows = np.vstack((self.jacobian, np.diag([1.0 / parameter.prior for parameter in self.parameters])))
        errors = np.vstack((sensitivity * sizes, np.zeros((len(self.parameters), sizes.size))))
        response = np.asarray(np.linalg.lstsq(rows, -errors, rcond=1e-12)[0], dtype=np.float64)
        left = (errors + rows @ response)[: self.residuals.size]
        freedom = max(self.residuals.size - self.values.size, 1)
        scale = (self.variance_factor - 1.0) * freedom / max(float(np.sum(left * left)), 1e-300)
        return replace(self, systematic=scale * response @ response.T)

    @property
    def errors(self) -> Array:
        """Standard deviations of the parameters (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def weak(self) -> tuple[Combination, ...]:
        """Parameter combinations that the data do not determine, weakest first."""
        return weak_combinations(self.jacobian / math.sqrt(max(self.variance_factor, 1.0)), self.parameters)

    def value(self, name: str) -> float:
        """Return a parameter's value by name."""
        return float(self.values[[p.name for p in self.parameters].index(name)])

    def interval(self, name: str) -> float:
        """Return half the 95 % confidence interval of a parameter."""
        return NORMAL_QUANTILE_95 * float(self.errors[[p.name for p in self.parameters].index(name)])


def weak_combinations(jacobian: Array, parameters: Sequence[Parameter]) -> tuple[Combination, ...]:
    """Return combinations that data with this Jacobian (m, p) do not determine, weakest first (by singular values)."""
    sizes = np.array([p.size for p in parameters])
    padded = np.vstack((jacobian * sizes, np.zeros((max(0, sizes.size - jacobian.shape[0]), sizes.size))))
    _, singular, vt = np.linalg.svd(padded, full_matrices=False)
    found: list[Combination] = []
    for value, direction in zip(singular[::-1], vt[::-1], strict=True):
        open_ = 1.0 / value if value > 1e-12 else math.inf
        if open_ <= MAX_OPEN_SHARE:
            break
        order: list[int] = np.argsort(-np.abs(direction)).tolist()
        parts = tuple((parameters[k].name, float(direction[k])) for k in order if abs(direction[k]) > 0.2)
        sign = math.copysign(1.0, parts[0][1])
        known = sum((share * p.size / p.prior) ** 2 for share, p in zip(direction, parameters, strict=True))
        found.append(Combination(tuple((name, sign * share) for name, share in parts), open_, known >= 0.2))
    return tuple(found)


def fit(
    problem: FitProblem, parameters: Sequence[Parameter], start: Array | None = None, max_steps: int = MAX_STEPS
) -> Fit:
    """Minimise the squared residuals and priors from `start` (p,); None: from zero.

    If the model has no shape at the parameters of a step, the step is shortened.

    Raises:
        PoseError, NoSolution: the model has no shape at the start, or for parameters near the current values.

    """
    from scipy.optimize import least_squares  # pyright: ignore  - slow to import

    has_prior = np.array([math.isfinite(p.prior) for p in parameters])
    weight = np.array([1.0 / p.prior for p in parameters])[has_prior]
    rows = np.diag([1.0 / p.prior for p in parameters])[has_prior]
    lower, upper = np.array([p.bounds for p in parameters]).T
    initial: Array = np.clip(np.zeros(len(parameters)) if start is None else start, lower, upper)
    size = problem.residuals(initial).size

    def residuals(values: Array) -> Array:
        try:
            errors = problem.residuals(values)
        except (NoSolution, PoseError):
            errors = np.full(size, math.inf)  # least_squares then shortens the step
        return np.concatenate((errors, weight * values[has_prior]))

    def jacobian(values: Array) -> Array:
        return np.vstack((problem.jacobian(values), rows))

    found: Any = cast(Any, least_squares)(
        residuals, initial, jacobian,
        bounds=(lower, upper), x_scale=[p.size for p in parameters],
        xtol=1e-9, ftol=1e-10, gtol=1e-10, max_nfev=max_steps,
    )  # fmt: skip
    values = np.asarray(found.x, dtype=np.float64)
    return Fit(tuple(parameters), values, problem.residuals(values), problem.jacobian(values))
