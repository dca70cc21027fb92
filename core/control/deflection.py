"""How fast the load bends the tip: the rate of Delta_total, eqs. (22) and (25).

Delta_total = F(q, w) - F(q, 0) is differentiated by a Kalman filter with a constant-velocity
model for each axis. Its gain settles within the first second and depends on nothing measured, so
it is computed once with filterpy; a tick then costs two multiplications an axis. The same filter
on the fused force gives w' for the exact rate, C(q, w) w' + (J(q, w) - J(q, 0)) q'.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array


class Rate(NamedTuple):
    """A filtered quantity and its rate of change."""

    value: Array  #: (3,) [m]
    rate: Array  #: (3,) [m/s]


@dataclass(frozen=True)
class RateFilter:
    """Steady-state Kalman filter for value and rate.

    A larger `bandwidth` follows a quicker load and passes more of the force sensors' noise.
    """

    period: float  #: [s]
    bandwidth: float = 1.0  #: [Hz]; sets the ratio of process to measurement noise
    gain: tuple[float, float] = field(init=False)  #: for value [1] and rate [1/s]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and self.period > 0.0):
            raise DescriptionError(f"filter period {self.period:g} s must be finite and greater than 0")
        nyquist = 0.5 / self.period
        if not 0.0 < self.bandwidth < nyquist:
            raise DescriptionError(f"filter bandwidth {self.bandwidth:g} Hz is outside 0 ... {nyquist:g} Hz")
        object.__setattr__(self, "gain", _steady_gain(self.period, self.bandwidth))

    def start(self, measured: Array) -> Rate:
        """At rest at the measured value (3,)."""
        return Rate(_finite(measured).copy(), np.zeros(3))

    def update(self, last: Rate, measured: Array | None) -> Rate:
        """One period on; `None` for a missing measurement lets the estimate coast.

        Raises:
            NotFinite: a NaN would stay in the filter for ever.

        """
        if measured is None:
            return Rate(last.value + self.period * last.rate, last.rate)
        new = Rate(np.empty(3), np.empty(3))
        filtered(*last, _finite(measured), *new, self.period, *self.gain)
        return new


@compiled
def filtered(
    value: Array, rate: Array, measured: Array, new_value: Array, new_rate: Array,
    period: float, k_value: float, k_rate: float,
) -> None:  # fmt: skip
    """`RateFilter.update`, from one pair of value and rate (3,) into the other."""
    for k in range(3):
        ahead = value[k] + period * rate[k]
        surprise = measured[k] - ahead
        new_value[k] = ahead + k_value * surprise
        new_rate[k] = rate[k] + k_rate * surprise


@cache
def _steady_gain(period: float, bandwidth: float) -> tuple[float, float]:
    """Kalman gain for value [1] and rate [1/s], from filterpy's recursion run until it stands."""
    from filterpy.common import Q_continuous_white_noise  # pyright: ignore
    from filterpy.kalman import KalmanFilter  # pyright: ignore

    kalman = cast(Any, KalmanFilter)(dim_x=2, dim_z=1)
    kalman.F = np.array([[1.0, period], [0.0, 1.0]])
    kalman.H = np.array([[1.0, 0.0]])
    # Continuous white acceleration of density w^4 R T gives a filter of bandwidth w.
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
