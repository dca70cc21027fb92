"""Where the tip is between tracker frames and during drop-outs: the model corrected by the tracker.

The model says at 500 Hz where the tip is, but not exactly; the tracker says it at 40 Hz, late and
noisy. What the model lacks, its bias, changes slowly with pose and load:

    X = F(q, w) + b,    b'' = white noise,

a Kalman filter of b and b' with one covariance for the three axes. A frame is compared with the
model's tip *of its own time*, kept in a short history, and corrects the present bias through
H = [1, -age]. Without frames the covariance grows: that is the uncertainty shown. A frame further
off than the gate is taken for a jump and left out. Frames in a row that are off by the same, though,
are no jump: something has moved the tip that the model does not know of, and the bias begins anew.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array

#: Standard deviation of the drift before anything is known of it [m/s].
FIRST_DRIFT = 1e-3
#: As many frames in a row that were left out, and that agree with each other, are believed.
BELIEVED = 8


class Observed(NamedTuple):
    """What the observer knows at one tick."""

    bias: Array  #: (3,) tracker minus model [m]
    drift: Array  #: (3,) rate of the bias [m/s]
    covariance: Array  #: (3,) equal for all axes: of the bias, of both, of the drift [m^2, m^2/s, m^2/s^2]
    tips: Array  #: (ticks, 3) the model's tips, the newest at `place` [m]
    place: int
    used: bool  #: a frame of this tick passed the gate
    refused: Array  #: (3,) by how much the latest frame that was left out surprised [m]
    in_a_row: int  #: so many frames in a row were left out

    @property
    def model_tip(self) -> Array:
        """(3,) the model's tip now, load filtered [m]."""
        return self.tips[self.place]

    @property
    def tip(self) -> Array:
        """(3,) the best estimate of the tip now [m]."""
        return self.tips[self.place] + self.bias

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the bias in each axis [m]."""
        return math.sqrt(self.covariance[0])


@dataclass(frozen=True)
class Observer:
    """Corrects the model's tip by the tracker's frames."""

    period: float  #: between ticks [s]
    noise: float = 1e-4  #: standard deviation of the tracker in each axis [m]
    bandwidth: float = 2.0  #: of the bias at 40 frames/s [Hz]; sets how far it is thought to wander
    gate: float = 8.0  #: standard deviations of a frame's surprise beyond which it is left out
    longest_age: float = 0.128  #: of a frame that can still be used [s]

    def __post_init__(self) -> None:
        for name, value, unit in (
            ("period", self.period, "s"), ("noise", self.noise, "m"), ("bandwidth", self.bandwidth, "Hz"),
            ("gate", self.gate, "standard deviations"), ("longest_age", self.longest_age, "s"),
        ):  # fmt: skip
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"observer: {name} {value:g} {unit} must be finite and greater than 0")

    @cached_property
    def wander(self) -> float:
        """Density of the bias' white acceleration [m^2/s^3]: w^4 R T gives a filter of bandwidth w."""
        return (2.0 * math.pi * self.bandwidth) ** 4 * self.noise**2 * 0.025

    def start(self, model_tip: Array, tip: Array) -> Observed:
        """With one frame `tip` (3,) of a robot at rest whose model is at `model_tip` (3,) [m]."""
        tips = np.tile(model_tip, (max(2, math.ceil(self.longest_age / self.period)), 1))
        covariance = np.array((self.noise**2, 0.0, FIRST_DRIFT**2))
        return Observed(_finite(tip) - model_tip, np.zeros(3), covariance, tips, 0, True, np.zeros(3), 0)

    def update(self, last: Observed, model_tip: Array, tip: Array | None, age: float = 0.0) -> Observed:
        """One tick on.

        Args:
            last: of the tick before.
            model_tip: (3,) the model's tip now [m].
            tip: (3,) a frame that has just arrived [m], or None.
            age: time since that frame was measured [s].

        Raises:
            NotFinite: a NaN would stay in the filter for ever.

        """
        if tip is not None:
            _finite(tip)
        bias, drift, covariance, tips, refused = (part.copy() for part in (*last[:4], last.refused))
        place, used, in_a_row = observe(
            bias, drift, covariance, tips, refused, last.place, last.in_a_row, model_tip,
            last.bias if tip is None else tip, -1.0 if tip is None else age,
            self.period, self.noise**2, self.wander, self.gate,
        )  # fmt: skip
        return Observed(bias, drift, covariance, tips, place, used, refused, in_a_row)


@compiled
def observe(
    bias: Array, drift: Array, covariance: Array, tips: Array, refused: Array, place: int, in_a_row: int,
    model_tip: Array, tip: Array, age: float, period: float, noise: float, wander: float, gate: float,
) -> tuple[int, bool, int]:  # fmt: skip
    """`Observer.update` in place; an `age` below 0 says that there is no frame.

    New place, whether the frame was used, and how many in a row were not.
    """
    ticks = tips.shape[0]
    place = (place + 1) % ticks
    for k in range(3):
        tips[place, k] = model_tip[k]
        bias[k] += period * drift[k]
    p, c, v = covariance[0], covariance[1], covariance[2]
    p += period * (2.0 * c + period * v) + wander * period**3 / 3.0
    c += period * v + wander * period**2 / 2.0
    v += wander * period
    back = age / period
    used = 0.0 <= back < ticks - 1
    if used:
        # The model's tip when the frame was measured, between two ticks.
        whole = int(back)
        part = back - whole
        later, earlier = (place - whole) % ticks, (place - whole - 1) % ticks
        pc, cv = p - age * c, c - age * v  # P H^T with H = [1, -age]
        expected = pc - age * cv + noise
        surprise = np.empty(3)
        for k in range(3):
            then = (1.0 - part) * tips[later, k] + part * tips[earlier, k]
            surprise[k] = tip[k] - then - (bias[k] - age * drift[k])
            used = used and abs(surprise[k]) <= gate * np.sqrt(expected)
        if not used:
            alike = in_a_row > 0
            for k in range(3):
                alike = alike and abs(surprise[k] - refused[k]) <= gate * np.sqrt(2.0 * noise)
                refused[k] = surprise[k]
            in_a_row = in_a_row + 1 if alike else 1
            if in_a_row >= BELIEVED:
                used, far = True, 0.0
                for k in range(3):
                    far += surprise[k] * surprise[k]
                p, c, v = far, 0.0, FIRST_DRIFT**2
                pc, cv = p, -age * v
                expected = pc - age * cv + noise
        if used:
            in_a_row = 0
            gain_bias, gain_drift = pc / expected, cv / expected
            for k in range(3):
                bias[k] += gain_bias * surprise[k]
                drift[k] += gain_drift * surprise[k]
            p, c, v = p - gain_bias * pc, c - gain_bias * cv, v - gain_drift * cv
    covariance[0], covariance[1], covariance[2] = p, c, v
    return place, used, in_a_row


def _finite(tip: Array) -> Array:
    if not np.isfinite(tip).all():
        raise NotFinite(f"measured tip {tip.tolist()} m is not finite")
    return tip
