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

from core.compiled import compiled, inlined
from core.control.actuation import Actuation, Motion, advance
from core.control.deflection import Rate, RateFilter, filtered
from core.control.observer import Observed, Observer, observe
from core.model.solution import Solution, places
from core.robot.robot import Array

#: Rows of `Estimate.vectors`.
(
    DIFFERENCE, DIFFERENCE_RATE, DEFLECTION, DEFLECTION_RATE, FORCE, FORCE_RATE, SMOOTH, LOAD_RATE, EXACT_RATE,
    DELTA_1, DELTA_2, VELOCITY, TIP_AHEAD,
) = range(13)  # fmt: skip


class Places(NamedTuple):
    """Where the parts of an estimate's numbers end; each begins where the one before does."""

    ticks: int  #: of velocities that are on their way
    n: int
    vectors: int
    state: int
    ahead: int
    sent: int
    tips: int
    place: int
    total: int


@inlined
def parts(ticks: int, n: int, history: int) -> Places:
    """For so many ticks of velocities on their way, n joints, and a history of so many tips."""
    ahead = 39 + 9 + n
    sent = ahead + ticks * n
    tips = sent + 3 * history
    return Places(ticks, n, 39, 48, ahead, sent, tips, tips + 1, tips + 2)


class Estimate:
    """What one tick knows; it is all that the next one needs. One array, and names for what is in it."""

    __slots__ = ("loaded", "numbers", "places", "unloaded")

    def __init__(self, loaded: Solution, unloaded: Solution, numbers: Array, places: Places) -> None:
        self.loaded = loaded  #: F(q, w)
        self.unloaded = unloaded  #: F(q, 0)
        self.numbers = numbers
        self.places = places

    @property
    def vectors(self) -> Array:
        """(13, 3) what follows from here on, up to `tip_ahead`."""
        return self.numbers[: self.places.vectors].reshape(13, 3)

    @property
    def motion(self) -> Motion:
        """Velocities of the joints, and their way until a command of now takes effect."""
        where = self.places
        sent = self.numbers[where.ahead : where.sent].reshape(where.ticks, where.n)
        return Motion(sent, self.numbers[where.state : where.ahead])

    @property
    def tip(self) -> Array:
        """(3,) the best estimate of the tip now [m]; `observed.tip`, quicker."""
        where, numbers = self.places, self.numbers
        at = where.sent + 3 * int(numbers[where.tips])
        return numbers[at : at + 3] + numbers[where.vectors : where.vectors + 3]

    @property
    def drift(self) -> Array:
        """(3,) rate of what the model lacks, as observed [m/s]."""
        return self.numbers[self.places.vectors + 3 : self.places.vectors + 6]

    @property
    def observed(self) -> Observed:
        """The tip."""
        where = self.places
        state = self.numbers[where.vectors : where.state].reshape(3, 3)
        tips = self.numbers[where.sent : where.tips].reshape(-1, 3)
        return Observed(state, tips, int(self.numbers[where.tips]), self.numbers[where.place] > 0.0)

    @property
    def difference(self) -> Array:
        """(3,) Delta_total as the models say it now [m]."""
        return self.vectors[DIFFERENCE]

    @property
    def difference_rate(self) -> Array:
        """(3,) its difference from the last tick, unfiltered [m/s]."""
        return self.vectors[DIFFERENCE_RATE]

    @property
    def deflection(self) -> Rate:
        """Delta_total, filtered [m], and its rate [m/s]."""
        return Rate(self.vectors[DEFLECTION], self.vectors[DEFLECTION_RATE])

    @property
    def force(self) -> Rate:
        """At the tip, filtered [N], and its rate [N/s]."""
        return Rate(self.vectors[FORCE], self.vectors[FORCE_RATE])

    @property
    def load_rate(self) -> Array:
        """(3,) C w' [m/s]."""
        return self.vectors[LOAD_RATE]

    @property
    def deflection_rate_exact(self) -> Array:
        """(3,) C w' + (J(q, w) - J(q, 0)) q' [m/s]."""
        return self.vectors[EXACT_RATE]

    @property
    def delta_1(self) -> Array:
        """(3,) integral of C dw, eq. (22) [m]."""
        return self.vectors[DELTA_1]

    @property
    def delta_2(self) -> Array:
        """(3,) integral of (J(q, w) - J(q, 0)) dq, eq. (22) [m]."""
        return self.vectors[DELTA_2]

    @property
    def velocity(self) -> Array:
        """(3,) of the tip, J q' + C w' + drift [m/s]."""
        return self.vectors[VELOCITY]

    @property
    def tip_ahead(self) -> Array:
        """(3,) the tip when a command of now takes effect [m]."""
        return self.vectors[TIP_AHEAD]


@dataclass(frozen=True)
class Estimator:
    """The filters of one controller."""

    filter: RateFilter  #: of deflection and force
    observer: Observer
    actuation: Actuation

    def start(self, loaded: Solution, unloaded: Solution, force: Array, tip: Array) -> Estimate:
        """At rest under `force` (3,) [N], the tracker showing `tip` (3,) [m]."""
        seen, motion = self.observer.start(loaded.tip, tip), self.actuation.start(loaded.joints.size)
        ticks, joints = motion.sent.shape
        where = parts(ticks, joints, len(seen.tips))
        numbers = np.zeros(where.total)
        now = Estimate(loaded, unloaded, numbers, where)
        now.vectors[DIFFERENCE] = now.vectors[DEFLECTION] = self.filter.start(loaded.tip - unloaded.tip).value
        now.vectors[FORCE] = now.vectors[SMOOTH] = self.filter.start(force).value
        now.vectors[TIP_AHEAD] = tip
        numbers[where.vectors : where.state] = seen.state.ravel()
        numbers[where.sent : where.tips] = seen.tips.ravel()
        numbers[where.place] = seen.used
        return now

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
        numbers = estimate(
            self.settings, loaded.places.q, loaded.numbers, unloaded.numbers,
            last.loaded.numbers, last.unloaded.numbers, last.numbers, force, sent,
            sent if tip is None else tip, -1.0 if tip is None else age,
        )  # fmt: skip
        return Estimate(loaded, unloaded, numbers, last.places)

    @cached_property
    def settings(self) -> Array:
        """What `estimate` is told at every tick."""
        observer, actuation = self.observer, self.actuation
        ticks = len(actuation.start(1).sent)
        history = len(observer.start(np.zeros(3), np.zeros(3)).tips)
        return np.array([
            self.filter.period, *self.filter.gain, 0.5 * actuation.hold, actuation.lead,
            observer.noise**2, observer.wander, observer.gate, ticks, history,
        ])  # fmt: skip


@compiled
def estimate(
    settings: Array, q: int, loaded: Array, unloaded: Array, old_loaded: Array, old_unloaded: Array,
    last: Array, force: Array, sent_now: Array, frame: Array, age: float,
) -> Array:  # fmt: skip
    """`Estimator.update`; solutions and estimates as their numbers."""
    period, k_value, k_rate, wait, lead, noise, wander, gate = settings[:8]
    n = sent_now.shape[0]
    mine = parts(int(settings[8]), n, int(settings[9]))
    where = places(q, n)  # where the parts end: each begins where the one before does
    jacobian, compliance, joints, wrench = where.rotation, where.jacobian, where.sensitivity, where.joints
    numbers = last.copy()
    old, new, model_tip = last[: mine.vectors].reshape(13, 3), numbers[: mine.vectors].reshape(13, 3), np.empty(3)
    state = numbers[mine.vectors : mine.state].reshape(3, 3)
    ahead = numbers[mine.state : mine.ahead]
    moved = numbers[mine.ahead : mine.sent].reshape(mine.ticks, n)
    tips = numbers[mine.sent : mine.tips].reshape(int(settings[9]), 3)
    advance(last[mine.ahead : mine.sent].reshape(mine.ticks, n), sent_now, period, wait, moved, ahead)
    velocity = moved[-1]
    for i in range(3):
        new[DIFFERENCE, i] = loaded[i] - unloaded[i]
        new[DIFFERENCE_RATE, i] = (new[DIFFERENCE, i] - old[DIFFERENCE, i]) / period
    filtered(old[DEFLECTION:FORCE], new[DIFFERENCE], new[DEFLECTION:FORCE], period, k_value, k_rate)
    filtered(old[FORCE:SMOOTH], force, new[FORCE:SMOOTH], period, k_value, k_rate)
    for i in range(3):
        new[SMOOTH, i] = old[SMOOTH, i] + period * new[FORCE_RATE, i]
    for i in range(3):
        along, extra_way, by_force, by_joints, way, extra_rate = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        model_tip[i] = loaded[i]
        for j in range(6):
            c = compliance + 6 * i + j
            along += 0.5 * (old_loaded[c] + loaded[c]) * (loaded[wrench + j] - old_loaded[wrench + j])
        for j in range(3):
            c = compliance + 6 * i + j
            by_force += loaded[c] * new[FORCE_RATE, j]
            # A single sample's noise would shake the tip by a millimetre. The force taken here moves at the rate
            # that is taken below, so that what both lag behind shows in the bias and in its drift alike.
            model_tip[i] += loaded[c] * (new[SMOOTH, j] - force[j])
        for j in range(n):
            k = jacobian + n * i + j
            extra, old_extra = loaded[k] - unloaded[k], old_loaded[k] - old_unloaded[k]
            extra_way += 0.5 * (extra + old_extra) * (loaded[joints + j] - old_loaded[joints + j])
            extra_rate += extra * velocity[j]
            by_joints += loaded[k] * velocity[j]
            way += loaded[k] * ahead[j]
        new[LOAD_RATE, i] = by_force
        new[EXACT_RATE, i] = by_force + extra_rate
        new[DELTA_1, i] = old[DELTA_1, i] + along
        new[DELTA_2, i] = old[DELTA_2, i] + extra_way
        new[VELOCITY, i] = by_force + by_joints
        new[TIP_AHEAD, i] = model_tip[i] + way + lead * by_force
    place, used = observe(state, tips, int(last[mine.tips]), model_tip, frame, age, period, noise, wander, gate)
    numbers[mine.tips], numbers[mine.place] = place, used
    for i in range(3):
        new[VELOCITY, i] += state[1, i]
        new[TIP_AHEAD, i] += state[0, i] + lead * state[1, i]
    return numbers
