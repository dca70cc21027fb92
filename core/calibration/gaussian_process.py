"""Gaussian process with a Matern 3/2 kernel: fit of its length scales, and prediction from few support points.

All outputs share one kernel. The fit maximises the marginal likelihood (Rasmussen and Williams, 2006, eq. 5.8 and 5.9)
times a log-normal prior of each length scale, so that an input with little variation keeps its expected scale.
"""

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array

#: Standard deviation of the prior of the logarithm of a length scale.
SCALE_SPREAD = 0.7
#: Smallest and largest signal and noise, as fractions of the outputs' RMS.
BOUNDS = (1e-2, 10.0)
#: Largest length scale, as a multiple of the range of its inputs. Farther away than that, the prediction is unknown.
MAX_SCALE_RANGE = 2.0
#: Largest number of points for the fit of the length scales; with more points, only every k-th point is used.
MAX_POINTS = 240
#: Number added to the diagonal of a kernel matrix without noise, which keeps the matrix invertible.
JITTER = 1e-5


class Kernel(NamedTuple):
    """Fitted kernel."""

    scales: Array  #: (d,) length scale of each input; inf: the input has no effect
    noise: float  #: variance of the noise, as a fraction of the variance of the signal


class Prediction(NamedTuple):
    """Prediction from m support points with kernel values k: mean W^T k, explained share of the variance k^T B k."""

    support: Array  #: (m, d) inputs of the support points
    weights: Array  #: (m, c) matrix W of the mean
    explained: Array  #: (m, m) matrix B of the explained share


def matern(a: Array, b: Array, scales: Array) -> Array:
    """Return the kernel values (p, q) of points (p, d) and (q, d)."""
    root = np.sqrt(3.0 * sum(((a[:, None, i] - b[None, :, i]) / s) ** 2 for i, s in enumerate(scales)))
    return (1.0 + root) * np.exp(-root)


def fit_kernel(points: Array, values: Array, groups: NDArray[np.int64], expected: Array) -> Kernel:
    """Fit the length scales to values (m, c) at points (m, d).

    Args:
        points: inputs (m, d).
        values: outputs (m, c) with zero mean before the data are known.
        groups: index (d,) of the length scale of each input.
        expected: median (g,) of the prior of each length scale; inf: the inputs have no effect.

    """
    from scipy.optimize import minimize  # pyright: ignore  - slow to import

    stride = -(-len(points) // MAX_POINTS)
    some, size = points[::stride], math.sqrt(float(np.mean(values[::stride] ** 2)))
    outputs, used = values[::stride] / max(size, 1e-300), np.flatnonzero(np.isfinite(expected))
    members = [some[:, groups == g] / expected[g] for g in used]
    squares = [((each[:, None] - each[None]) ** 2).sum(axis=2) for each in members]
    m, c = outputs.shape

    def cost(x: Array) -> tuple[float, Array]:
        shrunk = [square * math.exp(-2.0 * each) for square, each in zip(squares, x, strict=False)]
        root = np.sqrt(3.0 * sum(shrunk, np.zeros((m, m))))
        small, signal, noise = np.exp(-root), math.exp(2.0 * x[-2]), math.exp(2.0 * x[-1])
        kernel = signal * (1.0 + root) * small
        factor = np.linalg.cholesky(kernel + (noise + JITTER * signal) * np.eye(m))
        root_inverse = np.linalg.solve(factor, np.eye(m))
        inverse = root_inverse.T @ root_inverse
        solved = inverse @ outputs
        inner = 0.5 * (c * inverse - solved @ solved.T)
        by_scale = [3.0 * signal * float(np.sum(inner * small * each)) for each in shrunk]
        by_size = [2.0 * float(np.sum(inner * kernel)), 2.0 * noise * float(np.trace(inner))]
        likelihood = 0.5 * float(np.sum(outputs * solved)) + c * float(np.sum(np.log(np.diag(factor))))
        prior = x[:-2] / SCALE_SPREAD**2
        return likelihood + 0.5 * float(prior @ x[:-2]), np.array([*(by_scale + prior), *by_size])

    ranges = [float(np.ptp(each, axis=0).max()) for each in members]
    upper = [min(3.0, math.log(MAX_SCALE_RANGE * each)) if each > 1e-6 else 0.0 for each in ranges]
    limits = [(min(-3.0, each - 0.1), each) for each in upper] + [tuple(np.log(BOUNDS))] * 2
    start = np.array([*([0.0] * len(used)), -0.3, -0.7])
    result: Any = cast(Any, minimize)(cost, start, jac=True, method="L-BFGS-B", bounds=limits)
    found: Array = result.x
    scales = expected.copy()
    scales[used] *= np.exp(found[:-2])
    return Kernel(scales[groups], float(np.exp(2.0 * (found[-1] - found[-2]))))


def condition(kernel: Kernel, points: Array, values: Array, max_support: int) -> Prediction:
    """Return the prediction from values (m, c) at points (m, d), from at most `max_support` of the points.

    A pivoted Cholesky factorisation selects the support points: each has the largest variance that remains after the
    points before it. All values determine the weights (deterministic training conditional; Quinonero-Candela and
    Rasmussen, 2005). With all points as support points this is the exact Gaussian process.
    """
    count = min(max_support, len(points))
    chosen, left, rows = list[int](), np.ones(len(points)), np.empty((count, len(points)))
    for k in range(count):
        chosen.append(int(np.argmax(left)))
        row = matern(points[chosen[-1:]], points, kernel.scales)[0] - rows[:k].T @ rows[:k, chosen[-1]]
        rows[k] = row / math.sqrt(max(float(left[chosen[-1]]), JITTER))
        left = left - rows[k] ** 2
        left[chosen] = -1.0
    support, noise = points[chosen], max(kernel.noise, JITTER)
    own = matern(support, support, kernel.scales) + JITTER * np.eye(count)
    cross = matern(support, points, kernel.scales)
    information = noise * own + cross @ cross.T
    explained = np.linalg.inv(own) - noise * np.linalg.inv(information)
    weights = np.asarray(np.linalg.solve(information, cross @ values), dtype=np.float64)
    return Prediction(support, weights, 0.5 * (explained + explained.T))
