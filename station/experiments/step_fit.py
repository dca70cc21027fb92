"""Fit of a first-order lag with dead time to a step response of the tip, for comparison with the paper's eq. (31).

The control loop contains an integrator, so the final value equals the step. The fit finds the rate and the dead time.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from core.robot.robot import Array


class StepFit(NamedTuple):
    """Parameters of the fitted response y(t) = 1 - exp(-rate (t - dead_time)), which is 0 before the dead time."""

    rate: float  #: rate of the first-order lag [1/s]
    dead_time: float  #: dead time before the response starts [s]


def fit_step(times: Array, response: Array) -> StepFit:
    """Return the least-squares fit of the response (m,) to a unit step at time 0, `times` (m,) [s]."""

    def miss(parameters: Array) -> Array:
        rate, dead_time = parameters
        return -np.expm1(-rate * np.maximum(times - dead_time, 0.0)) - response

    # The time at which the response reaches 63 % gives an initial rate of the right order of magnitude.
    reached = float(times[np.argmax(response >= 1.0 - math.exp(-1.0))])
    found = least_squares(miss, (1.0 / max(reached, 0.02), 0.02), bounds=((1e-3, 0.0), (1e3, 1.0)))
    return StepFit(*map(float, found.x))


def fold(times: Array, response: Array, stay: float) -> tuple[Array, Array]:
    """Average the response to a square wave into one step response; a last, incomplete level is dropped.

    `stay` is the time at each level of the square wave [s].
    """
    each = int(np.searchsorted(times, times[0] + stay - 1e-9))
    stays = response[: len(response) // each * each].reshape(-1, each)
    back = np.arange(len(stays)) % 2 == 1
    return times[:each] - times[0], np.where(back[:, None], 1.0 - stays, stays).mean(axis=0)
