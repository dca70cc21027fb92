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
from typing import NamedTuple

import numpy as np

from core.actuation import Actuation, Motion, advance
from core.compiled import compiled
from core.deflection import Rate, RateFilter, filtered
from core.observer import Observed, Observer, observe
from core.robot import Array
from core.statics import Solution


class Estimate(NamedTuple):
    """What one tick knows; it is all that the next one needs."""

    loaded: Solution  #: F(q, w)
    unloaded: Solution  #: F(q, 0)
    difference: Array  #: (3,) Delta_total as the models say it now [m]
    difference_rate: Array  #: (3,) its difference from the last tick, unfiltered [m/s]
    deflection: Rate  #: Delta_total, filtered, and its rate
    force: Rate  #: at the tip, filtered [N], and its rate [N/s]
    smooth: Array  #: (3,) integral of that rate: the force again, calmer and later [N]
    load_rate: Array  #: (3,) C w' [m/s]
    deflection_rate_exact: Array  #: (3,) C w' + (J(q, w) - J(q, 0)) q' [m/s]
    delta_1: Array  #: (3,) integral of C dw, eq. (22) [m]
    delta_2: Array  #: (3,) integral of (J(q, w) - J(q, 0)) dq, eq. (22) [m]
    motion: Motion  #: of the joints
    observed: Observed  #: the tip
    velocity: Array  #: (3,) of the tip, J q' + C w' + drift [m/s]
    tip_ahead: Array  #: (3,) the tip when a command of now takes effect [m]


@dataclass(frozen=True)
class Estimator:
    """The filters of one controller."""

    filter: RateFilter  #: of deflection and force
    observer: Observer
    actuation: Actuation

    def start(self, loaded: Solution, unloaded: Solution, force: Array, tip: Array) -> Estimate:
        """At rest under `force` (3,) [N], the tracker showing `tip` (3,) [m]."""
        zero, difference = np.zeros(3), loaded.tip - unloaded.tip
        observed = self.observer.start(loaded.tip, tip)
        return Estimate(
            loaded, unloaded, difference, zero, self.filter.start(difference), self.filter.start(force), force, zero,
            zero, zero, zero, self.actuation.start(loaded.joints.size), observed, zero, tip,
        )  # fmt: skip

    def update(
        self, last: Estimate, loaded: Solution, unloaded: Solution,
        force: Array, sent: Array, tip: Array | None, age: float,
    ) -> Estimate:  # fmt: skip
        """One tick on.

        Args:
            last: of the tick before.
            loaded, unloaded: the models now.
            force: (3,) at the tip as measured, the one `loaded` was solved for [N].
            sent: (n,) velocities that went out to the stages last [rad/s or m/s].
            tip, age: a tracker frame that has just arrived (3,) [m] and the time since it was measured [s].

        """
        observer, actuation, old = self.observer, self.actuation, last.observed
        bias, drift, covariance, tips = old.bias.copy(), old.drift.copy(), old.covariance.copy(), old.tips.copy()
        vectors, moved, velocity, ahead, place, used = _estimate(
            self.filter.period, *self.filter.gain, 0.5 * actuation.hold, actuation.lead,
            loaded.tip, loaded.jacobian, loaded.compliance, loaded.joints, loaded.wrench,
            unloaded.tip, unloaded.jacobian,
            last.loaded.jacobian, last.loaded.compliance, last.loaded.joints, last.loaded.wrench,
            last.unloaded.jacobian,
            last.difference, *last.deflection, *last.force, last.smooth, force, last.delta_1, last.delta_2, last.motion.sent, sent,
            bias, drift, covariance, tips, old.place, bias if tip is None else tip, -1.0 if tip is None else age,
            observer.noise**2, observer.wander, observer.gate,
        )  # fmt: skip
        (
            difference, difference_rate, deflection, deflection_rate, value, rate, load_rate, exact_rate,
            delta_1, delta_2, tip_velocity, tip_ahead, smooth,
        ) = vectors  # fmt: skip
        return Estimate(
            loaded, unloaded, difference, difference_rate, Rate(deflection, deflection_rate), Rate(value, rate), smooth,
            load_rate, exact_rate, delta_1, delta_2, Motion(moved, velocity, ahead),
            Observed(bias, drift, covariance, tips, place, used), tip_velocity, tip_ahead,
        )  # fmt: skip


@compiled
def _estimate(
    period: float, k_value: float, k_rate: float, wait: float, lead: float,
    tip: Array, jacobian: Array, compliance: Array, joints: Array, wrench: Array, free_tip: Array, free_jacobian: Array,
    old_jacobian: Array, old_compliance: Array, old_joints: Array, old_wrench: Array, old_free_jacobian: Array,
    old_difference: Array, deflection: Array, deflection_rate: Array, force: Array, force_rate: Array,
    smooth: Array, measured_force: Array, delta_1: Array, delta_2: Array, sent: Array, sent_now: Array,
    bias: Array, drift: Array, covariance: Array, tips: Array, place: int, frame: Array,
    age: float, noise: float, wander: float, gate: float,
) -> tuple[Array, Array, Array, Array, int, bool]:  # fmt: skip
    """`Estimator.update`; the vectors (13, 3) in the order in which it takes them apart."""
    n = joints.shape[0]
    out = np.zeros((13, 3))
    out[0] = tip - free_tip
    out[1] = (out[0] - old_difference) / period
    out[2], out[3] = filtered(deflection, deflection_rate, out[0], period, k_value, k_rate)
    out[4], out[5] = filtered(force, force_rate, measured_force, period, k_value, k_rate)
    out[12] = smooth + period * out[5]
    moved, velocity, ahead = advance(sent, sent_now, period, wait)
    model_tip = tip.copy()
    for i in range(3):
        out[8, i], out[9, i] = delta_1[i], delta_2[i]
        for j in range(6):
            out[8, i] += 0.5 * (old_compliance[i, j] + compliance[i, j]) * (wrench[j] - old_wrench[j])
        for j in range(3):
            out[6, i] += compliance[i, j] * out[5, j]
            # A single sample's noise would shake the tip by a millimetre. The force taken here moves at the rate
            # that is taken below, so that what both lag behind shows in the bias and in its drift alike.
            model_tip[i] += compliance[i, j] * (out[12, j] - measured_force[j])
        out[7, i] = out[10, i] = out[6, i]
        for j in range(n):
            extra = jacobian[i, j] - free_jacobian[i, j]
            old_extra = old_jacobian[i, j] - old_free_jacobian[i, j]
            out[9, i] += 0.5 * (extra + old_extra) * (joints[j] - old_joints[j])
            out[7, i] += extra * velocity[j]
            out[10, i] += jacobian[i, j] * velocity[j]
            out[11, i] += jacobian[i, j] * ahead[j]
    place, used = observe(bias, drift, covariance, tips, place, model_tip, frame, age, period, noise, wander, gate)
    for i in range(3):
        out[10, i] += drift[i]
        out[11, i] += model_tip[i] + bias[i] + lead * (out[6, i] + drift[i])
    return out, moved, velocity, ahead, place, used
