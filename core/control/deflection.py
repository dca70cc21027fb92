"""Rate of the deflection under load, d(Delta_total)/dt, eqs. (22) and (25).

The deflection is Delta_total = F(q, w) - F(q, 0): the model's tip for joints q and load w, minus the tip without load.
A Kalman filter with a constant-velocity model for each axis differentiates the deflection. The filter's gain settles
within the first second and does not depend on measurements. The gain is therefore computed once with filterpy; a tick
then costs two multiplications per axis. The same filter on the measured force gives w' for the exact rate, C(q, w) w' +
(J(q, w) - J(q, 0)) q'.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array


class FilteredRate(NamedTuple):
    """A filtered deflection and its rate of change; the same filter also serves the force, in N and N/s."""

    value: Array  #: (3,) filtered deflection [m]
    rate: Array  #: (3,) rate of change of the filtered deflection [m/s]


@dataclass(frozen=True)
class RateFilter:
    """Steady-state Kalman filter for a quantity and its rate of change.

    A filter with larger `bandwidth` follows a quicker load and passes more of the force sensors' noise.
    """

    period: float  #: time between two measurements [s]
    bandwidth: float = 1.0  #: bandwidth of the filter [Hz]; it sets the ratio of process to measurement noise
    gain: tuple[float, float] = field(init=False)  #: Kalman gains for value [1] and rate [1/s]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0.0):
            raise DescriptionError(f"filter period {self.period:g} s must be finite and greater than 0")
        nyquist = 0.5 / self.period
        if not 0.0 < self.bandwidth < nyquist:
            raise DescriptionError(f"filter bandwidth {self.bandwidth:g} Hz is outside 0 ... {nyquist:g} Hz")
        object.__setattr__(self, "gain", _steady_gain(self.period, self.bandwidth))

    def start(self, measured: Array) -> FilteredRate:
        """Return the filter's state for a constant quantity with the measured value (3,)."""
        return FilteredRate(_finite(measured).copy(), np.zeros(3))

    def update(self, last: FilteredRate, measured: Array | None) -> FilteredRate:
        """Return the filter's state one period later; without a measurement (`None`) the state is extrapolated.

        Raises:
            NotFinite: the measurement is not finite; a NaN would stay in the filter forever.

        """
        if measured is None:
            return FilteredRate(last.value + self.period * last.rate, last.rate)
        new = FilteredRate(np.empty(3), np.empty(3))
        filtered(*last, _finite(measured), *new, self.period, *self.gain)
        return new


@compiled
def filtered(
    value: Array, rate: Array, measured: Array, new_value: Array, new_rate: Array,
    period: float, k_value: float, k_rate: float,
) -> None:  # fmt: skip
    """Compute `RateFilter.update` in compiled code; write the result to `new_value` and `new_rate` (3,)."""
    for k in range(3):
        ahead = value[k] + period * rate[k]
        surprise = measured[k] - ahead
        new_value[k] = ahead + k_value * surprise
        new_rate[k] = rate[k] + k_rate * surprise


@compiled
def gains(period: float, bandwidth: float) -> tuple[float, float]:
    """Return the gains for value [1] and rate [1/s] of a filter with this bandwidth [Hz], in closed form.

    The poles are those of the steady Kalman filter in continuous time, s = w (-1 +- i) / sqrt 2 with w = 2 pi
    bandwidth.
    """
    angle = math.sqrt(2.0) * math.pi * bandwidth * period
    radius = math.exp(-angle)
    value = 1.0 - radius * radius
    return value, (2.0 - value - 2.0 * radius * math.cos(angle)) / period


@cache
def _steady_gain(period: float, bandwidth: float) -> tuple[float, float]:
    """Return the Kalman gains for value [1] and rate [1/s] by running filterpy's recursion until it converges."""
    from filterpy.common import Q_continuous_white_noise  # pyright: ignore
    from filterpy.kalman import KalmanFilter  # pyright: ignore

    kalman = cast(Any, KalmanFilter)(dim_x=2, dim_z=1)
    kalman.F = np.array([[1.0, period], [0.0, 1.0]])
    kalman.H = np.array([[1.0, 0.0]])
    # White acceleration of density w^4 R T gives a filter of bandwidth w, with noise variance R = 1 and period T.
    density = (2.0 * math.pi * bandwidth) ** 4 * period
    kalman.Q = cast(Any, Q_continuous_white_noise)(dim=2, dt=period, spectral_density=density)
    kalman.P = np.diag([1.0, density / period])
    gain = np.zeros(2)
    for _ in range(100_000):
        kalman.predict()
        kalman.update(np.zeros(1))
        settled = np.abs(kalman.K[:, 0] - gain).max() <= 1e-13 * np.abs(gain).max()
        gain = kalman.K[:, 0].copy()
        if settled:
            break
    return float(gain[0]), float(gain[1])


def _finite(measured: Array) -> Array:
    if not np.isfinite(measured).all():
        raise NotFinite(f"deflection {measured.tolist()} m is not finite; the force or the joints are not")
    return measured
