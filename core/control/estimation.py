"""Estimates of one tick from the model with load and the model without load: deflection, load, joints and tip.

q are the joint positions, w is the load, J the Jacobian and C the compliance.

| estimate | how it is computed |
|---|---|
| deflection Delta_total, its numerical and its filtered rate | F(q, w) - F(q, 0), eq. (25) |
| tip velocity by the load, exact rate of Delta_total | C w', C w' + (J(q, w) - J(q, 0)) q'; w' of the filtered force |
| the deflection's parts Delta_1 and Delta_2 | eq. (22), integrated with the trapezoidal rule |
| the joints' velocity, and their travel until a command sent now takes effect | `actuation` |
| the tip, its velocity, and its predicted position | the model under the smoothed load, corrected by the `observer` |
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.actuation import Actuation, advance
from core.control.deflection import RateFilter, filtered, gains
from core.control.observer import Observer, ObserverState, observe
from core.control.tip_force import BANDWIDTH, QUALITY, LoadEstimator
from core.model.solution import Solution, fields
from core.robot.robot import Array

#: Indices of the scalars at the start of an estimate's array: number of joints; number of ticks with stored velocities;
#: number of stored tips; index of the newest tip; whether the observer used a tracker frame in this tick; number of
#: frames in a row that the observer rejected.
JOINT_COUNT, DELAY_TICKS, HISTORY_TICKS, NEWEST_INDEX, FRAME_USED, REJECTED_COUNT = range(6)
#: Index of the first vector in an estimate's array, after the scalars.
FIRST_VECTOR = 6
#: Index of the estimated force at the tip in an estimate's array, row 17 of the vectors.
FORCE_START = FIRST_VECTOR + 51
#: Time constant with which the smoothed force approaches the filtered force [s].
SMOOTHING_TIME_S = 30.0


class EstimateFields(NamedTuple):
    """Named views of an estimate's array; all vectors are in the world frame."""

    deflection: Array  #: (3,) deflection Delta_total: the model's loaded tip minus its unloaded tip [m]
    deflection_rate_raw: Array  #: (3,) change of the deflection since the last tick over the period, unfiltered [m/s]
    deflection_filtered: Array  #: (3,) filtered deflection [m]
    deflection_rate: Array  #: (3,) rate of the filtered deflection [m/s]
    force_filtered: Array  #: (3,) filtered force at the tip [N]
    force_rate: Array  #: (3,) rate of the filtered force [N/s]
    force_smooth: Array  #: (3,) smoothed force with the rate `force_rate` [N]
    load_rate: Array  #: (3,) tip velocity C w' that the changing load causes [m/s]
    deflection_rate_exact: Array  #: (3,) rate of the deflection, C w' + (J(q, w) - J(q, 0)) q' [m/s]
    delta_1: Array  #: (3,) part of the deflection caused by the load, integral of C dw, eq. (22) [m]
    delta_2: Array  #: (3,) part of the deflection caused by the joints, integral of (J(q, w) - J(q, 0)) dq [m]
    velocity_observed: Array  #: (3,) observed velocity of the tip, J q' + C w' + drift [m/s]
    tip_ahead: Array  #: (3,) predicted tip position when a command sent now takes effect [m]
    bias: Array  #: (3,) measured tip minus the model's tip [m]
    drift: Array  #: (3,) rate of the bias [m/s]
    refused: Array  #: (3,) innovation (measured minus expected tip) of the latest rejected tracker frame [m]
    bias_covariance: Array  #: (3,) variance of bias, their covariance, variance of drift [m^2, m^2/s, m^2/s^2]
    load: Array  #: (5, 3) estimate of the force at the tip, see `tip_force`
    vectors: Array  #: (22, 3) all vectors above in one matrix, one per row
    ahead: Array  #: (n,) distance that the joints still move until a command sent now takes effect [rad or m]
    sent: Array  #: (ticks, n) joint velocities sent to the stages, newest first [rad/s or m/s]
    tips: Array  #: (history, 3) the model's tips of the last ticks [m]


#: Unit of each vector in `EstimateFields`, in their order; telemetry has a channel for each vector.
VECTOR_UNITS = {
    "deflection": "m", "deflection_rate_raw": "m/s", "deflection_filtered": "m", "deflection_rate": "m/s",
    "force_filtered": "N", "force_rate": "N/s", "force_smooth": "N",
    "load_rate": "m/s", "deflection_rate_exact": "m/s", "delta_1": "m", "delta_2": "m",
    "velocity_observed": "m/s", "tip_ahead": "m", "bias": "m", "drift": "m/s", "refused": "m",
}  # fmt: skip


@compiled
def estimate_fields(numbers: Array) -> EstimateFields:
    """Return named views of an estimate's array."""
    n, ticks, history = int(numbers[JOINT_COUNT]), int(numbers[DELAY_TICKS]), int(numbers[HISTORY_TICKS])
    ahead = FIRST_VECTOR + 66
    sent = ahead + n
    tips = sent + ticks * n
    v = numbers[FIRST_VECTOR:ahead].reshape(22, 3)
    return EstimateFields(
        v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11], v[12], v[13], v[14], v[15], v[16],
        v[17:], v,
        numbers[ahead:sent], numbers[sent:tips].reshape(ticks, n), numbers[tips:].reshape(history, 3),
    )  # fmt: skip


class Estimate:
    """Estimates of one tick, and the state of the filters that the next tick needs."""

    __slots__ = ("_known", "loaded", "numbers", "unloaded")

    def __init__(self, loaded: Solution, unloaded: Solution, numbers: Array) -> None:
        self.loaded = loaded  #: solved model under the estimated load
        self.unloaded = unloaded  #: solved model without load
        self.numbers = numbers  #: all estimates in one array; `known` names its parts
        self._known: EstimateFields | None = None

    @property
    def known(self) -> EstimateFields:
        """Named views of the array `numbers`."""
        if self._known is None:
            self._known = estimate_fields(self.numbers)
        return self._known

    @property
    def force(self) -> Array:
        """(3,) estimated force at the tip, `known.load[FORCE]`; reading it is faster than `known` [N]."""
        return self.numbers[FORCE_START : FORCE_START + 3]

    @property
    def observed(self) -> ObserverState:
        """State of the tip observer."""
        known, newest = self.known, int(self.numbers[NEWEST_INDEX])
        return ObserverState(
            known.bias, known.drift, known.bias_covariance, known.tips, newest, self.numbers[FRAME_USED] > 0.0,
            known.refused, int(self.numbers[REJECTED_COUNT]),
        )  # fmt: skip


@dataclass(frozen=True)
class Estimator:
    """The filters of a controller: deflection, force, tip observer and command path."""

    filter: RateFilter  #: filter of deflection and force
    observer: Observer
    actuation: Actuation
    load: LoadEstimator = field(default_factory=LoadEstimator)  #: estimator of the force at the tip

    def start(self, loaded: Solution, unloaded: Solution, force: Array, tip: Array) -> Estimate:
        """Return the estimate at rest under `force` (3,) [N] with the measured tip `tip` (3,) [m]."""
        observed, motion = self.observer.start(loaded.tip, tip), self.actuation.start(loaded.joints.size)
        ticks, n = motion.sent.shape
        history = len(observed.tips)
        numbers = np.zeros(FIRST_VECTOR + 66 + n + ticks * n + 3 * history)
        numbers[JOINT_COUNT], numbers[DELAY_TICKS], numbers[HISTORY_TICKS], numbers[FRAME_USED] = (
            n,
            ticks,
            history,
            observed.used,
        )
        now = Estimate(loaded, unloaded, numbers)
        known = now.known
        known.deflection[:] = known.deflection_filtered[:] = self.filter.start(loaded.tip - unloaded.tip).value
        known.force_filtered[:] = known.force_smooth[:] = self.filter.start(force).value
        known.load[:] = self.load.start(force, self.filter.bandwidth)
        known.tip_ahead[:] = tip
        known.bias[:], known.drift[:], known.bias_covariance[:], known.tips[:] = observed[:4]
        return now

    @cached_property
    def settings(self) -> Array:
        """Packed filter settings, the first argument of `estimate`."""
        observer, actuation = self.observer, self.actuation
        return np.array([
            self.filter.period, *((-1.0, 0.0) if self.load.adapts else self.filter.gain),
            0.5 * actuation.command_interval, actuation.lead_time,
            observer.noise**2, observer.wander, observer.gate,
        ])  # fmt: skip


@compiled
def estimate(
    settings: Array, loaded: Array, unloaded: Array, old_loaded: Array, old_unloaded: Array,
    last: Array, force: Array, sent_now: Array, frame: Array, age: float, numbers: Array,
) -> None:  # fmt: skip
    """Compute the estimate of one tick into `numbers`.

    Args:
        settings: packed settings `Estimator.settings`.
        loaded, unloaded: arrays of this tick's solutions with and without load.
        old_loaded, old_unloaded, last: solutions and estimate of the previous tick.
        force: (3,) estimated force at the tip, for which `loaded` was solved [N].
        sent_now: (n,) joint velocities sent to the stages last [rad/s or m/s].
        frame, age: a new tracker frame (3,) [m] and the time since it was measured [s]; age below 0: no frame.
        numbers: array of the new estimate; on entry a copy of `last` that already contains this tick's `load`.

    """
    period, k_value, k_rate, wait, lead_time, noise, wander, gate = settings
    if k_value < 0.0:
        k_value, k_rate = gains(period, estimate_fields(numbers).load[QUALITY, BANDWIDTH])
    with_load, free, had_load, was_free = fields(loaded), fields(unloaded), fields(old_loaded), fields(old_unloaded)
    old, new = estimate_fields(last), estimate_fields(numbers)
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
    # The smoothed force has the rate `force_rate`. While the gains change with the pose, its sum would drift away from
    # the filter's state, so it also approaches the value that it has at constant gains.
    lag, leak = k_value / k_rate - period, period / SMOOTHING_TIME_S
    for i in range(3):
        steady = new.force_filtered[i] - lag * new.force_rate[i]
        new.force_smooth[i] = old.force_smooth[i] + period * new.force_rate[i]
        new.force_smooth[i] += leak * (steady - new.force_smooth[i])
    for i in range(3):
        along, extra_travel, by_force, by_joints, travel, extra_rate = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        model_tip[i] = with_load.tip[i]
        for j in range(6):
            compliance = 0.5 * (had_load.compliance[i, j] + with_load.compliance[i, j])
            along += compliance * (with_load.wrench[j] - had_load.wrench[j])
        for j in range(3):
            by_force += with_load.compliance[i, j] * new.force_rate[j]
            # The force noise of a single sample would move the model's tip by a millimetre, so the tip is evaluated
            # under the smoothed force. The smoothed force has the rate `force_rate`, which `load_rate` also uses. The
            # lag of both therefore appears consistently in the bias and its drift.
            model_tip[i] += with_load.compliance[i, j] * (new.force_smooth[j] - force[j])
        for j in range(velocity.shape[0]):
            extra = with_load.jacobian[i, j] - free.jacobian[i, j]
            old_extra = had_load.jacobian[i, j] - was_free.jacobian[i, j]
            extra_travel += 0.5 * (extra + old_extra) * (with_load.joints[j] - had_load.joints[j])
            extra_rate += extra * velocity[j]
            by_joints += with_load.jacobian[i, j] * velocity[j]
            travel += with_load.jacobian[i, j] * new.ahead[j]
        new.load_rate[i] = by_force
        new.deflection_rate_exact[i] = by_force + extra_rate
        new.delta_1[i] = old.delta_1[i] + along
        new.delta_2[i] = old.delta_2[i] + extra_travel
        new.velocity_observed[i] = by_force + by_joints
        new.tip_ahead[i] = model_tip[i] + travel + lead_time * by_force
    numbers[NEWEST_INDEX], numbers[FRAME_USED], numbers[REJECTED_COUNT] = observe(
        new.bias, new.drift, new.bias_covariance, new.tips, new.refused, int(last[NEWEST_INDEX]),
        int(last[REJECTED_COUNT]),
        model_tip, frame, age, period, noise, wander, gate,
    )  # fmt: skip
    for i in range(3):
        new.velocity_observed[i] += new.drift[i]
        new.tip_ahead[i] += new.bias[i] + lead_time * new.drift[i]
