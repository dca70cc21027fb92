"""Filters of a tick: the deflection's rate, the observed tip, and the tip velocity from tracker frames.

**Deflection's rate** d(Delta_total)/dt, eqs. (22) and (25). The deflection is Delta_total = F(q, w) - F(q, 0): the
model's tip for joints q and load w, minus the tip without load. A Kalman filter with a constant-velocity model for each
axis differentiates the deflection. The filter's gain settles within the first second and does not depend on
measurements. The gain is therefore computed once with filterpy; a tick then costs two multiplications per axis. The
same filter on the measured force gives w' for the exact rate, C(q, w) w' + (J(q, w) - J(q, 0)) q'.

**Tip observer.** A filter estimates the tip's position between tracker frames and during drop-outs of the tracker. The
model F(q, w) gives the tip X at 500 Hz for joints q and load w, with a model error. The tracker gives the tip at 40 Hz,
delayed and noisy. The difference, the bias b of the model, changes slowly with pose and load:

    X = F(q, w) + b,    b'' = white noise,

A Kalman filter estimates b and its rate b', with one covariance for the three axes. A tracker frame is compared with
the model's tip *at the time of the frame's measurement*, from a short history. The frame corrects the present bias
through the measurement matrix H = [1, -age]. Without frames the covariance grows; the displayed uncertainty follows
from this covariance. Since the last frame that it used, the bias is extrapolated for at most `LONGEST_S` and by at most
`FARTHEST_M`; then it is constant. A frame whose innovation (measured minus expected tip) exceeds the gate is rejected
as an outlier. After `REACQUIRE_FRAMES` rejected frames in a row whose differences from the model agree with each other,
the observer assumes that a cause outside the model has moved the tip, and initialises the bias again, with the rate
zero.

**Tip velocity from tracker frames** that the joints do not cause, X'_meas - J(q, w) q' of eqs. (28) and (29). This
velocity is the difference quotient of two tracker frames, minus the tip motion that the joints cause between them. The
velocity is not filtered and therefore contains the noise of two frames 25 ms apart, as the paper warns.
"""

import math
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array, positive

#: End of the error text for a deflection that is not finite.
_CAUSE = "; a measured force or joint position is not finite"


class FilteredRate(NamedTuple):
    """A filtered deflection and its rate of change; for the force, the same fields are in N and N/s."""

    value: Array  #: (3,) filtered deflection [m]
    rate: Array  #: (3,) rate of change of the filtered deflection [m/s]


#: Results of `steady_gain` for the period [s] and the bandwidths [Hz] of the presets. They are stored because importing
#: filterpy, and with it scipy.stats, takes a quarter of the processor time of a station's start.
USUAL_GAINS = {
    (0.002, 0.3): (0.005317272533449318, 0.007087197450309125),
    (0.002, 1.0): (0.01761454939670001, 0.07825835113622626),
    (0.002, 10.0): (0.16281926682410866, 7.224359426340568),
}


@dataclass(frozen=True)
class RateFilter:
    """Steady-state Kalman filter for a quantity and its rate of change.

    A filter with a larger `bandwidth` follows a faster load and passes more of the force sensors' noise.
    """

    period: float  #: time between two measurements [s]
    bandwidth: float = 1.0  #: bandwidth of the filter [Hz]; it sets the ratio of process to measurement noise
    gain: tuple[float, float] = field(init=False)  #: Kalman gains for value [1] and rate [1/s]

    def __post_init__(self) -> None:
        positive("filter period", self.period, "s")
        nyquist = 0.5 / self.period
        if not 0.0 < self.bandwidth < nyquist:
            raise DescriptionError(f"filter bandwidth {self.bandwidth:g} Hz is outside 0 ... {nyquist:g} Hz")
        gain = USUAL_GAINS.get((self.period, self.bandwidth)) or steady_gain(self.period, self.bandwidth)
        object.__setattr__(self, "gain", gain)

    def start(self, measured: Array) -> FilteredRate:
        """Return the filter's state for a constant quantity with the measured value (3,)."""
        return FilteredRate(_finite(measured, "deflection", _CAUSE).copy(), np.zeros(3))

    def update(self, last: FilteredRate, measured: Array | None) -> FilteredRate:
        """Return the filter's state one period later; without a measurement (`None`) the state is extrapolated.

        Raises:
            NotFinite: the measurement is not finite; a NaN would stay in the filter forever.

        """
        if measured is None:
            return FilteredRate(last.value + self.period * last.rate, last.rate)
        new = FilteredRate(np.empty(3), np.empty(3))
        filtered(*last, _finite(measured, "deflection", _CAUSE), *new, self.period, *self.gain)
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
def steady_gain(period: float, bandwidth: float) -> tuple[float, float]:
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


#: Initial standard deviation of the drift, the rate of the model's bias [m/s].
FIRST_DRIFT_STD_M_S = 1e-3
#: Number of rejected frames in a row that agree with each other, at which the observer accepts the frames.
REACQUIRE_FRAMES = 8
#: Longest time [s] and largest distance [m] by which the bias is extrapolated after the last frame that was used. A
#: drift that few noisy frames have shown must not move the tip far.
LONGEST_S, FARTHEST_M = 0.25, 3e-3


class ObserverState(NamedTuple):
    """State of the observer at one tick."""

    bias: Array  #: (3,) tracker's tip minus model's tip [m]
    drift: Array  #: (3,) rate of the bias [m/s]
    covariance: Array  #: (3,) variance of bias, covariance of bias and drift, variance of drift [m^2, m^2/s, m^2/s^2]
    tips: Array  #: (ticks, 3) the model's tips of the last ticks, the newest at index `newest` [m]
    newest: int  #: index of the newest tip in `tips`
    used: bool  #: whether a tracker frame arrived in this tick and passed the gate
    refused: Array  #: (3,) measured tip minus the model's tip in the latest rejected frame [m]
    in_a_row: int  #: number of frames rejected in a row
    unused: int  #: number of ticks since a frame was used

    @property
    def model_tip(self) -> Array:
        """(3,) tip of the model in this tick, under the smoothed load [m]."""
        return self.tips[self.newest]

    @property
    def tip(self) -> Array:
        """(3,) best estimate of the tip in this tick: model plus bias [m]."""
        return self.tips[self.newest] + self.bias

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the bias in each axis [m]."""
        return math.sqrt(self.covariance[0])


@dataclass(frozen=True)
class Observer:
    """Kalman filter that corrects the model's tip with the tracker's frames."""

    period: float  #: time between two ticks [s]
    noise: float = 1e-4  #: standard deviation of the tracker in each axis [m]
    bandwidth: float = 2.0  #: bandwidth of the bias estimate at 40 frames/s [Hz]; it sets the bias' process noise
    gate: float = 8.0  #: innovation beyond which a frame is rejected [standard deviations]
    longest_age: float = 0.128  #: largest age of a tracker frame that can still be used [s]

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("period", self.period, "s"), ("noise", self.noise, "m"), ("bandwidth", self.bandwidth, "Hz"),
            ("gate", self.gate, "standard deviations"), ("longest_age", self.longest_age, "s"),
        ):  # fmt: skip
            positive(f"observer: {name}", value, unit)

    @cached_property
    def wander(self) -> float:
        """Density of the bias' white acceleration [m^2/s^3].

        The density w^4 R T gives a filter of bandwidth w, for noise variance R and time T between frames.
        """
        return (2.0 * math.pi * self.bandwidth) ** 4 * self.noise**2 * 0.025

    def start(self, model_tip: Array, tip: Array) -> ObserverState:
        """Return the observer's state after one tracker frame `tip` (3,) [m] of a robot at rest.

        `model_tip` (3,) is the model's tip at the same time [m].
        """
        tips = np.tile(model_tip, (max(2, math.ceil(self.longest_age / self.period)), 1))
        covariance = np.array((self.noise**2, 0.0, FIRST_DRIFT_STD_M_S**2))
        return ObserverState(
            _finite(tip, "measured tip") - model_tip, np.zeros(3), covariance, tips, 0, True, np.zeros(3), 0, 0
        )

    def update(self, last: ObserverState, model_tip: Array, tip: Array | None, age: float = 0.0) -> ObserverState:
        """Return the observer's state one tick later.

        Args:
            last: state of the previous tick.
            model_tip: the model's tip (3,) in this tick [m].
            tip: tip (3,) in a new tracker frame [m]; None if no frame arrived.
            age: time since that frame was measured [s].

        Raises:
            NotFinite: the tracker frame contains NaN or infinity; a NaN would stay in the filter forever.

        """
        if tip is not None:
            _finite(tip, "measured tip")
        bias, drift, covariance, tips, refused = (part.copy() for part in (*last[:4], last.refused))
        newest, used, in_a_row, unused = observe(
            bias, drift, covariance, tips, refused, last.newest, last.in_a_row, last.unused, model_tip,
            last.bias if tip is None else tip, -1.0 if tip is None else age,
            self.period, self.noise**2, self.wander, self.gate,
        )  # fmt: skip
        return ObserverState(bias, drift, covariance, tips, newest, used, refused, in_a_row, unused)


@compiled
def observe(
    bias: Array, drift: Array, covariance: Array, tips: Array, refused: Array, newest: int, in_a_row: int,
    unused: int, model_tip: Array, tip: Array, age: float, period: float, noise: float, wander: float, gate: float,
) -> tuple[int, bool, int, int]:  # fmt: skip
    """Compute `Observer.update` in place; an `age` below 0 means that there is no tracker frame.

    Returns the index of the newest tip, whether the frame was used, the number of frames rejected in a row, and the
    number of ticks since a frame was used.
    """
    ticks = tips.shape[0]
    newest, unused = (newest + 1) % ticks, unused + 1
    since = period * unused
    speed = math.sqrt(drift[0] ** 2 + drift[1] ** 2 + drift[2] ** 2)
    if since > LONGEST_S or since * speed > FARTHEST_M:
        drift[:] = 0.0
    for k in range(3):
        tips[newest, k] = model_tip[k]
        bias[k] += period * drift[k]
    p, c, v = covariance[0], covariance[1], covariance[2]
    p += period * (2.0 * c + period * v) + wander * period**3 / 3.0
    c += period * v + wander * period**2 / 2.0
    v += wander * period
    back = age / period
    used = 0.0 <= back < ticks - 1
    if used:
        # Interpolate the model's tip at the time when the frame was measured, which lies between two ticks.
        whole = int(back)
        part = back - whole
        later, earlier = (newest - whole) % ticks, (newest - whole - 1) % ticks
        pc, cv = p - age * c, c - age * v  # P H^T with H = [1, -age]
        expected = pc - age * cv + noise
        innovation, apart = np.empty(3), np.empty(3)
        for k in range(3):
            then = (1.0 - part) * tips[later, k] + part * tips[earlier, k]
            apart[k] = tip[k] - then
            innovation[k] = apart[k] - (bias[k] - age * drift[k])
            used = used and abs(innovation[k]) <= gate * np.sqrt(expected)
        if not used:
            alike = in_a_row > 0
            for k in range(3):
                alike = alike and abs(apart[k] - refused[k]) <= gate * np.sqrt(2.0 * noise)
                refused[k] = apart[k]
            in_a_row = in_a_row + 1 if alike else 1
            if in_a_row >= REACQUIRE_FRAMES:
                used, squared = True, 0.0
                for k in range(3):
                    innovation[k] = apart[k] - bias[k]
                    drift[k] = 0.0
                    squared += innovation[k] * innovation[k]
                p, c, v = squared, 0.0, FIRST_DRIFT_STD_M_S**2
                pc, cv = p, -age * v
                expected = pc - age * cv + noise
        if used:
            in_a_row, unused = 0, 0
            gain_bias, gain_drift = pc / expected, cv / expected
            for k in range(3):
                bias[k] += gain_bias * innovation[k]
                drift[k] += gain_drift * innovation[k]
            p, c, v = p - gain_bias * pc, c - gain_bias * cv, v - gain_drift * cv
    covariance[0], covariance[1], covariance[2] = p, c, v
    return newest, used, in_a_row, unused


def _finite(measured: Array, what: str, cause: str = "") -> Array:
    if not np.isfinite(measured).all():
        raise NotFinite(f"{what} {measured.tolist()} m is not finite{cause}")
    return measured


class TrackerVelocity(NamedTuple):
    """Tip velocity from the last two tracker frames, and the state that the next frame needs."""

    velocity: Array  #: (3,) tip velocity that the joints do not cause, X'_meas - J q' [m/s]
    travel: Array  #: (3,) tip displacement that the joints caused since the newest frame [m]
    since: float  #: time since the newest frame was measured [s]


#: State before two tracker frames have arrived: zero velocity.
NO_FRAMES = TrackerVelocity(np.zeros(3), np.zeros(3), 0.0)


def differentiate(
    last: TrackerVelocity, by_joints: Array, before: Array, frame: Array | None, age: float, period: float
) -> TrackerVelocity:
    """Return the velocity from tracker frames one tick later.

    Args:
        last: state of the last tick.
        by_joints: tip velocity (3,) that the joints cause, J(q, w) q' [m/s].
        before: tip (3,) in the newest frame so far [m].
        frame: tip (3,) in a new frame [m]; None: no new frame.
        age: time since the new frame was measured [s].
        period: time between two ticks [s].
    """
    since, travel = last.since + period, last.travel + period * by_joints
    span = since - age
    if frame is None or span <= 0.0:  # no frame arrived, or the frame is not newer than the last one
        return TrackerVelocity(last.velocity, travel, since)
    return TrackerVelocity((frame - before - travel) / span, np.zeros(3), age)
