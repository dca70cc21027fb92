"""Tip observer: a filter that estimates the tip's position between tracker frames and during drop-outs of the tracker.

The model F(q, w) gives the tip X at 500 Hz for joints q and load w, with a model error. The tracker gives the tip at
40 Hz, delayed and noisy. The difference, the bias b of the model, changes slowly with pose and load:

    X = F(q, w) + b,    b'' = white noise,

A Kalman filter estimates b and its rate b', with one covariance for the three axes. A tracker frame is compared with
the model's tip *at the time of the frame's measurement*, from a short history. The frame corrects the present bias
through the measurement matrix H = [1, -age]. Without frames the covariance grows; the displayed uncertainty follows
from this covariance. A frame whose innovation (measured minus expected tip) exceeds the gate is rejected as an outlier.
After `REACQUIRE_FRAMES` rejected frames in a row that agree with each other, the observer assumes that a cause outside
the model has moved the tip, and initialises the bias again.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array

#: Initial standard deviation of the drift, the rate of the model's bias [m/s].
FIRST_DRIFT_STD_M_S = 1e-3
#: Number of rejected frames in a row that agree with each other, at which the observer accepts the frames.
REACQUIRE_FRAMES = 8


class ObserverState(NamedTuple):
    """State of the observer at one tick."""

    bias: Array  #: (3,) tracker's tip minus model's tip [m]
    drift: Array  #: (3,) rate of the bias [m/s]
    covariance: Array  #: (3,) variance of bias, covariance of bias and drift, variance of drift [m^2, m^2/s, m^2/s^2]
    tips: Array  #: (ticks, 3) the model's tips of the last ticks, the newest at index `newest` [m]
    newest: int  #: index of the newest tip in `tips`
    used: bool  #: whether a tracker frame arrived in this tick and passed the gate
    refused: Array  #: (3,) innovation (measured minus expected tip) of the latest rejected frame [m]
    in_a_row: int  #: number of frames rejected in a row

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
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"observer: {name} {value:g} {unit} must be finite and greater than 0")

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
        return ObserverState(_finite(tip) - model_tip, np.zeros(3), covariance, tips, 0, True, np.zeros(3), 0)

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
            _finite(tip)
        bias, drift, covariance, tips, refused = (part.copy() for part in (*last[:4], last.refused))
        newest, used, in_a_row = observe(
            bias, drift, covariance, tips, refused, last.newest, last.in_a_row, model_tip,
            last.bias if tip is None else tip, -1.0 if tip is None else age,
            self.period, self.noise**2, self.wander, self.gate,
        )  # fmt: skip
        return ObserverState(bias, drift, covariance, tips, newest, used, refused, in_a_row)


@compiled
def observe(
    bias: Array, drift: Array, covariance: Array, tips: Array, refused: Array, newest: int, in_a_row: int,
    model_tip: Array, tip: Array, age: float, period: float, noise: float, wander: float, gate: float,
) -> tuple[int, bool, int]:  # fmt: skip
    """Compute `Observer.update` in place; an `age` below 0 means that there is no tracker frame.

    Returns the index of the newest tip, whether the frame was used, and the number of frames rejected in a row.
    """
    ticks = tips.shape[0]
    newest = (newest + 1) % ticks
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
        innovation = np.empty(3)
        for k in range(3):
            then = (1.0 - part) * tips[later, k] + part * tips[earlier, k]
            innovation[k] = tip[k] - then - (bias[k] - age * drift[k])
            used = used and abs(innovation[k]) <= gate * np.sqrt(expected)
        if not used:
            alike = in_a_row > 0
            for k in range(3):
                alike = alike and abs(innovation[k] - refused[k]) <= gate * np.sqrt(2.0 * noise)
                refused[k] = innovation[k]
            in_a_row = in_a_row + 1 if alike else 1
            if in_a_row >= REACQUIRE_FRAMES:
                used, squared = True, 0.0
                for k in range(3):
                    squared += innovation[k] * innovation[k]
                p, c, v = squared, 0.0, FIRST_DRIFT_STD_M_S**2
                pc, cv = p, -age * v
                expected = pc - age * cv + noise
        if used:
            in_a_row = 0
            gain_bias, gain_drift = pc / expected, cv / expected
            for k in range(3):
                bias[k] += gain_bias * innovation[k]
                drift[k] += gain_drift * innovation[k]
            p, c, v = p - gain_bias * pc, c - gain_bias * cv, v - gain_drift * cv
    covariance[0], covariance[1], covariance[2] = p, c, v
    return newest, used, in_a_row


def _finite(tip: Array) -> Array:
    if not np.isfinite(tip).all():
        raise NotFinite(f"measured tip {tip.tolist()} m is not finite")
    return tip
