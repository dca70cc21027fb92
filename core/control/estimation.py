"""What is estimated in a tick beside the two solves: deflection, load, joints and tip.

| estimate | equation |
|---|---|
| Delta_total, its numerical and its filtered rate | F(q, w) - F(q, 0), eq. (25) |
| C w', and the exact rate of Delta_total | C w' + (J(q, w) - J(q, 0)) q', w' from the filtered force |
| Delta_1, Delta_2 | eq. (22), by trapezia |
| the joints' velocity, and their way until a command of now takes effect | `actuation` |
| the tip, its velocity and where it will be by then | model under the smoothed load, corrected by the `observer` |
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.actuation import Actuation, advance
from core.control.deflection import RateFilter, filtered
from core.control.observer import Observed, Observer, observe
from core.model.solution import Solution, parts
from core.robot.robot import Array

#: Places of the single numbers of an estimate: how many joints, ticks of velocities that are on their way and kept
#: tips there are; which of these is the newest, whether the observer has used a frame of this tick, and how many in a
#: row it has left out.
JOINTS, TICKS, HISTORY, NEWEST, USED, REFUSED = range(6)
#: Behind them the vectors begin.
VECTORS_AT = 6


class Known(NamedTuple):
    """Views of an estimate's numbers. All vectors in the world frame."""

    deflection: Array  #: (3,) Delta_total as the models say it now [m]
    deflection_rate_raw: Array  #: (3,) its difference from the last tick, unfiltered [m/s]
    deflection_filtered: Array  #: (3,) [m]
    deflection_rate: Array  #: (3,) of the filtered one [m/s]
    force_filtered: Array  #: (3,) at the tip [N]
    force_rate: Array  #: (3,) of the filtered one [N/s]
    force_smooth: Array  #: (3,) integral of `force_rate` [N]
    load_rate: Array  #: (3,) C w' [m/s]
    deflection_rate_exact: Array  #: (3,) C w' + (J(q, w) - J(q, 0)) q' [m/s]
    delta_1: Array  #: (3,) integral of C dw, eq. (22) [m]
    delta_2: Array  #: (3,) integral of (J(q, w) - J(q, 0)) dq, eq. (22) [m]
    velocity_observed: Array  #: (3,) of the tip, J q' + C w' + drift [m/s]
    tip_ahead: Array  #: (3,) the tip when a command of now takes effect [m]
    bias: Array  #: (3,) what the tracker sees less what the model says [m]
    drift: Array  #: (3,) rate of the bias [m/s]
    refused: Array  #: (3,) by how much the latest frame that was left out surprised [m]
    bias_covariance: Array  #: (3,) of the bias, of both, of the drift [m^2, m^2/s, m^2/s^2]
    vectors: Array  #: (17, 3) all of these, one a row
    ahead: Array  #: (n,) way of the joints until a command of now takes effect [rad or m]
    sent: Array  #: (ticks, n) velocities that went out, newest first [rad/s or m/s]
    tips: Array  #: (history, 3) the model's tips of the last ticks [m]


#: Unit of each vector, in the order of `Known`; telemetry has a channel for each.
VECTORS = {
    "deflection": "m", "deflection_rate_raw": "m/s", "deflection_filtered": "m", "deflection_rate": "m/s",
    "force_filtered": "N", "force_rate": "N/s", "force_smooth": "N",
    "load_rate": "m/s", "deflection_rate_exact": "m/s", "delta_1": "m", "delta_2": "m",
    "velocity_observed": "m/s", "tip_ahead": "m", "bias": "m", "drift": "m/s", "refused": "m",
}  # fmt: skip


@compiled
def known_of(numbers: Array) -> Known:
    """What lies where in an estimate's numbers."""
    n, ticks, history = int(numbers[JOINTS]), int(numbers[TICKS]), int(numbers[HISTORY])
    ahead = VECTORS_AT + 51
    sent = ahead + n
    tips = sent + ticks * n
    v = numbers[VECTORS_AT:ahead].reshape(17, 3)
    return Known(
        v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11], v[12], v[13], v[14], v[15], v[16],
        v,
        numbers[ahead:sent], numbers[sent:tips].reshape(ticks, n), numbers[tips:].reshape(history, 3),
    )  # fmt: skip


class Estimate:
    """What one tick knows; it is all that the next one needs."""

    __slots__ = ("_known", "loaded", "numbers", "unloaded")

    def __init__(self, loaded: Solution, unloaded: Solution, numbers: Array) -> None:
        self.loaded = loaded  #: F(q, w)
        self.unloaded = unloaded  #: F(q, 0)
        self.numbers = numbers  #: `known` names them
        self._known: Known | None = None

    @property
    def known(self) -> Known:
        """Names for the numbers."""
        if self._known is None:
            self._known = known_of(self.numbers)
        return self._known

    @property
    def observed(self) -> Observed:
        """The tip, as the observer knows it."""
        known, newest = self.known, int(self.numbers[NEWEST])
        return Observed(
            known.bias, known.drift, known.bias_covariance, known.tips, newest, self.numbers[USED] > 0.0,
            known.refused, int(self.numbers[REFUSED]),
        )  # fmt: skip


@dataclass(frozen=True)
class Estimator:
    """The filters of one controller."""

    filter: RateFilter  #: of deflection and force
    observer: Observer
    actuation: Actuation

    def start(self, loaded: Solution, unloaded: Solution, force: Array, tip: Array) -> Estimate:
        """At rest under `force` (3,) [N], the tracker showing `tip` (3,) [m]."""
        seen, motion = self.observer.start(loaded.tip, tip), self.actuation.start(loaded.joints.size)
        ticks, n = motion.sent.shape
        history = len(seen.tips)
        numbers = np.zeros(VECTORS_AT + 51 + n + ticks * n + 3 * history)
        numbers[JOINTS], numbers[TICKS], numbers[HISTORY], numbers[USED] = n, ticks, history, seen.used
        now = Estimate(loaded, unloaded, numbers)
        known = now.known
        known.deflection[:] = known.deflection_filtered[:] = self.filter.start(loaded.tip - unloaded.tip).value
        known.force_filtered[:] = known.force_smooth[:] = self.filter.start(force).value
        known.tip_ahead[:] = tip
        known.bias[:], known.drift[:], known.bias_covariance[:], known.tips[:] = seen[:4]
        return now

    @cached_property
    def settings(self) -> Array:
        """What `estimate` is told at every tick."""
        observer, actuation = self.observer, self.actuation
        return np.array([
            self.filter.period, *self.filter.gain, 0.5 * actuation.hold, actuation.lead,
            observer.noise**2, observer.wander, observer.gate,
        ])  # fmt: skip


@compiled
def estimate(
    settings: Array, loaded: Array, unloaded: Array, old_loaded: Array, old_unloaded: Array,
    last: Array, force: Array, sent_now: Array, frame: Array, age: float, numbers: Array,
) -> None:  # fmt: skip
    """One tick on.

    Args:
        settings: `Estimator.settings`.
        loaded, unloaded: the models now, as the numbers of their solutions.
        old_loaded, old_unloaded, last: the models and the estimate of the tick before.
        force: (3,) at the tip as measured, the one that `loaded` was solved for [N].
        sent_now: (n,) velocities that went out to the stages last [rad/s or m/s].
        frame, age: a tracker frame that has just arrived (3,) [m] and the time since it was taken [s]; below 0: none.
        numbers: of the new estimate, as many as of `last`.

    """
    period, k_value, k_rate, wait, lead, noise, wander, gate = settings
    with_load, free, had_load, was_free = parts(loaded), parts(unloaded), parts(old_loaded), parts(old_unloaded)
    copy(last, numbers)
    old, new = known_of(last), known_of(numbers)
    advance(old.sent, sent_now, period, wait, new.sent, new.ahead)
    velocity, model_tip = new.sent[-1], np.empty(3)
    for i in range(3):
        new.deflection[i] = with_load.tip[i] - free.tip[i]
        new.deflection_rate_raw[i] = (new.deflection[i] - old.deflection[i]) / period
    filtered(
        old.deflection_filtered, old.deflection_rate, new.deflection,
        new.deflection_filtered, new.deflection_rate, period, k_value, k_rate,
    )  # fmt: skip
    filtered(
        old.force_filtered, old.force_rate, force, new.force_filtered, new.force_rate, period, k_value, k_rate
    )  # fmt: skip
    for i in range(3):
        new.force_smooth[i] = old.force_smooth[i] + period * new.force_rate[i]
    for i in range(3):
        along, extra_way, by_force, by_joints, way, extra_rate = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        model_tip[i] = with_load.tip[i]
        for j in range(6):
            compliance = 0.5 * (had_load.compliance[i, j] + with_load.compliance[i, j])
            along += compliance * (with_load.wrench[j] - had_load.wrench[j])
        for j in range(3):
            by_force += with_load.compliance[i, j] * new.force_rate[j]
            # A single sample's noise would shake the tip by a millimetre. The force taken here moves at the rate
            # that is taken below, so that what both lag behind shows in the bias and in its drift alike.
            model_tip[i] += with_load.compliance[i, j] * (new.force_smooth[j] - force[j])
        for j in range(velocity.shape[0]):
            extra = with_load.jacobian[i, j] - free.jacobian[i, j]
            old_extra = had_load.jacobian[i, j] - was_free.jacobian[i, j]
            extra_way += 0.5 * (extra + old_extra) * (with_load.joints[j] - had_load.joints[j])
            extra_rate += extra * velocity[j]
            by_joints += with_load.jacobian[i, j] * velocity[j]
            way += with_load.jacobian[i, j] * new.ahead[j]
        new.load_rate[i] = by_force
        new.deflection_rate_exact[i] = by_force + extra_rate
        new.delta_1[i] = old.delta_1[i] + along
        new.delta_2[i] = old.delta_2[i] + extra_way
        new.velocity_observed[i] = by_force + by_joints
        new.tip_ahead[i] = model_tip[i] + way + lead * by_force
    numbers[NEWEST], numbers[USED], numbers[REFUSED] = observe(
        new.bias, new.drift, new.bias_covariance, new.tips, new.refused, int(last[NEWEST]), int(last[REFUSED]),
        model_tip, frame, age, period, noise, wander, gate,
    )  # fmt: skip
    for i in range(3):
        new.velocity_observed[i] += new.drift[i]
        new.tip_ahead[i] += new.bias[i] + lead * new.drift[i]
