"""Least squares with an account of what the data say: intervals, and combinations that they cannot tell apart.

Every parameter has a size in which it is judged: how far it may be off before it matters. What a
person knows beforehand (a tube's length to a millimetre) is a prior of one more row; the account is made
from the data alone, in those sizes, so that a number that only the prior holds is never sold as measured.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from core.errors import CtrError, NoSolution, PoseError
from core.robot.robot import Array

#: A combination is told by the data when they leave less than this part of its size open.
TOLD = 0.5
#: Two-sided 95 % of a normal distribution.
INTERVAL = 1.959964


class Unobservable(CtrError):
    """The data cannot determine what was asked for; the text says what is missing."""


class Parameter(NamedTuple):
    """One unknown, as a deviation from where the fit starts."""

    name: str
    unit: str
    size: float  #: how far it may be off before it matters, in its unit
    prior: float = math.inf  #: standard deviation known beforehand, about 0; inf: nothing is known
    bounds: tuple[float, float] = (-math.inf, math.inf)


class Combination(NamedTuple):
    """A direction in the space of the parameters that the data leave open."""

    parts: tuple[tuple[str, float], ...]  #: parameters and their shares, in sizes, largest first
    open: float  #: standard deviation that the data alone leave it, in sizes; inf when they say nothing
    held: bool  #: whether priors hold it

    def __str__(self) -> str:
        """For a person."""
        shares = " ".join(f"{share:+.2f} {name}" for name, share in self.parts)
        return f"{shares} ({'held by what is known beforehand' if self.held else 'undetermined'})"


class Problem(Protocol):
    """What is fitted; every residual in units of its own standard deviation."""

    def residuals(self, values: Array) -> Array:
        """(m,) at parameters (p,)."""
        ...

    def jacobian(self, values: Array) -> Array:
        """(m, p)."""
        ...


@dataclass(frozen=True)
class Fit:
    """The outcome of a least-squares fit."""

    parameters: tuple[Parameter, ...]
    values: Array  #: (p,)
    residuals: Array  #: (m,) of the data, in standard deviations
    jacobian: Array  #: (m, p) at the solution

    @cached_property
    def variance_factor(self) -> float:
        """Chi square over degrees of freedom: 1 when the residuals are what the noise says."""
        return float(self.residuals @ self.residuals) / max(self.residuals.size - self.values.size, 1)

    @cached_property
    def covariance(self) -> Array:
        """(p, p), priors included; larger by the variance factor where the residuals are more than noise."""
        size = np.array([p.size for p in self.parameters])
        scaled = self.jacobian * size
        prior = np.diag([(p.size / p.prior) ** 2 for p in self.parameters])
        information = scaled.T @ scaled / max(self.variance_factor, 1.0) + prior
        inverse: Array = np.asarray(np.linalg.pinv(information, rcond=1e-14, hermitian=True), dtype=np.float64)
        return inverse * np.outer(size, size)

    @property
    def errors(self) -> Array:
        """Standard deviations (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def weak(self) -> tuple[Combination, ...]:
        """What the data cannot tell, weakest first."""
        return weak_combinations(self.jacobian / math.sqrt(max(self.variance_factor, 1.0)), self.parameters)

    def value(self, name: str) -> float:
        """A parameter's value by name."""
        return float(self.values[[p.name for p in self.parameters].index(name)])

    def interval(self, name: str) -> float:
        """Half the 95 % confidence interval of a parameter."""
        return INTERVAL * float(self.errors[[p.name for p in self.parameters].index(name)])


def weak_combinations(jacobian: Array, parameters: Sequence[Parameter]) -> tuple[Combination, ...]:
    """Combinations that data with this Jacobian (m, p) cannot tell, by its singular values in sizes; weakest first."""
    sizes = np.array([p.size for p in parameters])
    padded = np.vstack((jacobian * sizes, np.zeros((max(0, sizes.size - jacobian.shape[0]), sizes.size))))
    _, singular, vt = np.linalg.svd(padded, full_matrices=False)
    found: list[Combination] = []
    for value, direction in zip(singular[::-1], vt[::-1], strict=True):
        open_ = 1.0 / value if value > 1e-12 else math.inf
        if open_ <= TOLD:
            break
        order: list[int] = np.argsort(-np.abs(direction)).tolist()
        parts = tuple((parameters[k].name, float(direction[k])) for k in order if abs(direction[k]) > 0.2)
        sign = math.copysign(1.0, parts[0][1])
        known = sum((share * p.size / p.prior) ** 2 for share, p in zip(direction, parameters, strict=True))
        found.append(Combination(tuple((name, sign * share) for name, share in parts), open_, known >= 0.2))
    return tuple(found)


def fit(problem: Problem, parameters: Sequence[Parameter], start: Array | None = None) -> Fit:
    """Minimise the squared residuals and priors from `start` (p,), zeros when left out.

    A step to where the model has no shape is a step too far: it is shortened.

    Raises:
        PoseError, NoSolution: the model has no shape where the fit starts, or just beside where it is.

    """
    from scipy.optimize import least_squares  # pyright: ignore  - slow to import

    has_prior = np.array([math.isfinite(p.prior) for p in parameters])
    weight = np.array([1.0 / p.prior for p in parameters])[has_prior]
    rows = np.diag([1.0 / p.prior for p in parameters])[has_prior]
    lower, upper = np.array([p.bounds for p in parameters]).T
    begin: Array = np.clip(np.zeros(len(parameters)) if start is None else start, lower, upper)
    size = problem.residuals(begin).size

    def residuals(values: Array) -> Array:
        try:
            seen = problem.residuals(values)
        except (NoSolution, PoseError):
            seen = np.full(size, math.inf)  # which the search takes for a step that is too long
        return np.concatenate((seen, weight * values[has_prior]))

    def jacobian(values: Array) -> Array:
        return np.vstack((problem.jacobian(values), rows))

    found: Any = cast(Any, least_squares)(
        residuals, begin, jacobian,
        bounds=(lower, upper), x_scale=[p.size for p in parameters],
        xtol=1e-9, ftol=1e-10, gtol=1e-10, max_nfev=60,
    )  # fmt: skip
    values = np.asarray(found.x, dtype=np.float64)
    return Fit(tuple(parameters), values, problem.residuals(values), problem.jacobian(values))
