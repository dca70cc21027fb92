"""A step response as a first-order lag with dead time, to hold against eq. (31).

The loop has an integrator, so that the gain is one; what is fitted is how soon and how fast.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from core.robot.robot import Array


class StepFit(NamedTuple):
    """y(t) = 1 - exp(-rate (t - dead_time)) after the dead time."""

    rate: float  #: [1/s]
    dead_time: float  #: [s]


def fit_step(times: Array, response: Array) -> StepFit:
    """Least squares over the response (m,) to a unit step at time 0, `times` (m,) [s]."""

    def miss(parameters: Array) -> Array:
        rate, dead_time = parameters
        return -np.expm1(-rate * np.maximum(times - dead_time, 0.0)) - response

    # A start in the right decade: where 63 % are reached.
    reached = float(times[np.argmax(response >= 1.0 - math.exp(-1.0))])
    found = least_squares(miss, (1.0 / max(reached, 0.02), 0.02), bounds=((1e-3, 0.0), (1e3, 1.0)))
    return StepFit(*map(float, found.x))


def fold(times: Array, response: Array, stay: float) -> tuple[Array, Array]:
    """Average there and back again, `stay` [s] at either place, into one step; whole stays only."""
    each = int(np.searchsorted(times, times[0] + stay - 1e-9))
    stays = response[: len(response) // each * each].reshape(-1, each)
    back = np.arange(len(stays)) % 2 == 1
    return times[:each] - times[0], np.where(back[:, None], 1.0 - stays, stays).mean(axis=0)
