"""Where a target that breathes is now and will be in a moment, from tracker frames that come late and rarely.

Its place is taken as a constant and a few waves on each axis,

    x(t) = c + sum_k s_k(t),    s_k' = k w q_k,    q_k' = -k w s_k,

k = 1, 2, ... of each rhythm, whose rate w [rad/s] is the same for all axes and is found like the rest: an extended
Kalman filter of c, s, q and w. Everything may drift: the process noise says how quickly. A rate is found only from
one that is near, so several filters begin at several rates, and the one that has been surprised least speaks.
The waves carry the estimate to any time after the newest frame for a few sines.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, NotFinite
from core.robot.robot import Array

#: As many frames in a row that nobody expected are believed: the target has been moved.
BELIEVED = 8
#: How long a surprise is remembered when filters are compared [s].
MEMORY = 4.0
#: What a multiple that is larger than its first wave adds to a filter's surprise at every frame: of two that fit
#: equally, one at half the rate, the quicker one speaks.
UNLIKELY = 0.05


class Place(NamedTuple):
    """Where a target is at one moment."""

    position: Array  #: (3,) [m]
    velocity: Array  #: (3,) [m/s]


class Known(NamedTuple):
    """What is known of a target after its newest frame."""

    time: float  #: of that frame [s]
    states: Array  #: (filters, n) centre (3,) [m], then s and q (3,) of each wave [m], then rates [rad/s]
    covariances: Array  #: (filters, n, n) of the states
    surprises: Array  #: (filters, 2) minus the logarithm of the frames' likelihood; frames in a row beyond the gate


class Predictor(Protocol):
    """From frames to the target's place at any later time."""

    def start(self, position: Array, time: float) -> Known:
        """With a first frame `position` (3,) [m] that was measured at `time` [s]."""
        ...

    def update(self, last: Known, position: Array, time: float) -> Known:
        """With another frame, later than the last one."""
        ...

    def at(self, known: Known, time: float) -> Place:
        """At `time` [s]."""
        ...


@dataclass(frozen=True)
class NewestFrame:
    """No prediction: the target is where the newest frame saw it, and stands."""

    def start(self, position: Array, time: float) -> Known:
        """With a first frame."""
        return Known(time, _finite(position)[None].copy(), np.zeros((1, 3, 3)), np.zeros((1, 2)))

    def update(self, last: Known, position: Array, time: float) -> Known:
        """With another frame."""
        _later(last, time)
        return self.start(position, time)

    def at(self, known: Known, time: float) -> Place:  # noqa: ARG002 - wherever it goes meanwhile
        """Where it was seen last."""
        return Place(known.states[0], np.zeros(3))


class Rhythm(NamedTuple):
    """Waves with one rate: where the search for it begins, and where it may end."""

    rates: tuple[float, ...]  #: [Hz]
    spread: float  #: standard deviation about each of them [Hz]
    lowest: float  #: [Hz]
    highest: float  #: [Hz]
    waves: int  #: the first one and its multiples
    size: float  #: standard deviation of the first wave before anything is known; of the k-th over k^2 [m]


BREATHING = Rhythm((0.15, 0.25, 0.4), 0.03, 0.08, 0.65, 2, 5e-3)
HEARTBEAT = Rhythm((1.0, 1.5), 0.15, 0.8, 3.0, 1, 1e-3)


@dataclass(frozen=True)
class Waves:
    """Predicts by a constant and the waves of some rhythms."""

    rhythms: tuple[Rhythm, ...] = (BREATHING, HEARTBEAT)
    noise: float = 1e-4  #: standard deviation of a frame in each axis [m]
    centre_drift: float = 2e-4  #: random walk of the constant [m/s^0.5]
    wave_drift: float = 0.03  #: of every wave, as a part of its size [1/s^0.5]
    floor: float = 2e-5  #: the same of a wave that is not there [m/s^0.5]
    rate_drift: float = 0.006  #: of every rhythm [Hz/s^0.5]
    gate: float = 8.0  #: standard deviations beyond which a frame surprises

    def __post_init__(self) -> None:
        for name in ("noise", "centre_drift", "wave_drift", "floor", "rate_drift", "gate"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise DescriptionError(f"waves: {name} {getattr(self, name):g} must be finite and greater than 0")
        for rhythm in self.rhythms:
            wrong = [rate for rate in rhythm.rates if not 0.0 < rhythm.lowest <= rate <= rhythm.highest < math.inf]
            if wrong or not rhythm.rates or rhythm.waves < 1:
                raise DescriptionError(
                    f"waves: a rhythm of {rhythm.waves} waves from {rhythm.rates} Hz, inside {rhythm.lowest:g} ..."
                    f" {rhythm.highest:g} Hz: give at least one wave, and rates inside of bounds above 0 Hz"
                )

    @cached_property
    def _waves(self) -> Array:
        """Rhythm and multiple of each wave (waves, 2)."""
        listed = [(of, k + 1) for of, rhythm in enumerate(self.rhythms) for k in range(rhythm.waves)]
        return np.array(listed, dtype=np.float64).reshape(-1, 2)

    @cached_property
    def _first(self) -> tuple[Array, Array]:
        """Rates (filters, rhythms) [rad/s] and variances of each state before anything is known but the place."""
        turn = 2.0 * math.pi
        rates = np.array(list(itertools.product(*(rhythm.rates for rhythm in self.rhythms))))
        spreads = np.array([(turn * rhythm.spread) ** 2 for rhythm in self.rhythms])
        waves = np.repeat([(self.rhythms[int(of)].size / k**2) ** 2 for of, k in self._waves], 6)
        return turn * rates, np.concatenate((np.full(3, self.noise**2 + waves[:1].sum()), waves, spreads))

    @cached_property
    def _settings(self) -> tuple[Array, Array, Array]:
        """Waves; process noise of each part of the state in a second; bounds of the rates (rhythms, 2) [rad/s]."""
        turn = 2.0 * math.pi
        drifts = np.concatenate(
            (
                np.full(3, self.centre_drift**2), np.full(6 * len(self._waves), self.floor**2),
                np.full(len(self.rhythms), (turn * self.rate_drift) ** 2),
            )
        )  # fmt: skip
        bounds = turn * np.array([(rhythm.lowest, rhythm.highest) for rhythm in self.rhythms]).reshape(-1, 2)
        return self._waves, drifts, bounds

    def start(self, position: Array, time: float) -> Known:
        """With a first frame."""
        rates, variances = self._first
        still = np.concatenate((_finite(position), np.zeros(6 * len(self._waves))))
        states = np.concatenate((np.tile(still, (len(rates), 1)), rates), axis=1)
        return Known(time, states, np.tile(np.diag(variances), (len(rates), 1, 1)), np.zeros((len(rates), 2)))

    def update(self, last: Known, position: Array, time: float) -> Known:
        """With another frame.

        Raises:
            NotFinite: a NaN would stay in the filter for ever.
            DescriptionError: the frame is not later than the last one.
        """
        now = Known(time, last.states.copy(), last.covariances.copy(), last.surprises.copy())
        _update(
            *now[1:], *self._settings, *self._first, _finite(position), _later(last, time),
            self.noise**2, self.wave_drift**2, self.gate,
        )  # fmt: skip
        return now

    def at(self, known: Known, time: float) -> Place:
        """The waves carried on to `time` [s]."""
        place = Place(np.empty(3), np.empty(3))
        _carried(known.states, known.surprises, self._waves, time - known.time, *place)
        return place

    def rates(self, known: Known) -> Array:
        """The rate of each rhythm (rhythms,) [Hz]."""
        best = known.states[known.surprises[:, 0].argmin()]
        return best[3 + 6 * len(self._waves) :] / (2.0 * math.pi)


@compiled
def _update(
    states: Array, covariances: Array, surprises: Array, waves: Array, drifts: Array, bounds: Array,
    rates: Array, variances: Array, position: Array, span: float, noise: float, along: float, gate: float,
) -> None:  # fmt: skip
    """A frame `span` [s] after the last one, for every filter, in place."""
    forgotten = math.exp(-span / MEMORY)
    for each in range(states.shape[0]):
        _advance(states[each], covariances[each], waves, drifts, along, span)
        surprise, in_a_row = _correct(
            states[each], covariances[each], waves.shape[0], bounds, rates[each], variances,
            position, noise, gate, surprises[each, 1],
        )  # fmt: skip
        surprises[each, 0] = forgotten * surprises[each, 0] + surprise + _unlikely(states[each], waves)
        surprises[each, 1] = in_a_row


@compiled
def _advance(state: Array, covariance: Array, waves: Array, drifts: Array, along: float, span: float) -> None:
    """State and covariance `span` [s] on, in place."""
    n, count = state.shape[0], waves.shape[0]
    rates = 3 + 6 * count
    for j in range(n):
        covariance[j, j] += span * drifts[j]
    for k in range(count):
        rate, size = rates + int(waves[k, 0]), 0.0
        turn = waves[k, 1] * span
        cos, sin = math.cos(turn * state[rate]), math.sin(turn * state[rate])
        for i in range(3):
            s, q = 3 + 6 * k + i, 6 + 6 * k + i
            state[s], state[q] = cos * state[s] + sin * state[q], cos * state[q] - sin * state[s]
            size += state[s] * state[s] + state[q] * state[q]
            # F P F^T, two rows and two columns at a time; the rate's own do not change.
            to_s, to_q = turn * state[q], -turn * state[s]
            for j in range(n):
                a, b, w = covariance[s, j], covariance[q, j], covariance[rate, j]
                covariance[s, j], covariance[q, j] = cos * a + sin * b + to_s * w, cos * b - sin * a + to_q * w
            for j in range(n):
                a, b, w = covariance[j, s], covariance[j, q], covariance[j, rate]
                covariance[j, s], covariance[j, q] = cos * a + sin * b + to_s * w, cos * b - sin * a + to_q * w
        for j in range(3 + 6 * k, 9 + 6 * k):
            covariance[j, j] += span * along * size / 3.0


@compiled
def _correct(
    state: Array, covariance: Array, waves: int, bounds: Array, rates: Array, variances: Array,
    position: Array, noise: float, gate: float, in_a_row: float,
) -> tuple[float, float]:  # fmt: skip
    """State and covariance with a frame, in place: how much it surprised, and how many in a row beyond the gate."""
    n, seen, surprise, off = state.shape[0], np.empty(state.shape[0]), 0.0, False
    for i in range(3):
        expected, variance = _seen(state, covariance, waves, i, seen)
        off = off or (position[i] - expected) ** 2 > gate**2 * (variance + noise)
    in_a_row = in_a_row + 1.0 if off else 0.0
    if in_a_row >= BELIEVED:
        # What is known is a beginning, and no more.
        for j in range(n):
            for k in range(n):
                covariance[j, k] = 0.0
            covariance[j, j] = variances[j]
        for of in range(rates.shape[0]):
            state[3 + 6 * waves + of] = rates[of]
        for i in range(3):
            expected, variance = _seen(state, covariance, waves, i, seen)
            state[i] += position[i] - expected
        in_a_row = 0.0
    for i in range(3):
        expected, variance = _seen(state, covariance, waves, i, seen)
        variance += noise
        miss = position[i] - expected
        surprise += 0.5 * (miss * miss / variance + math.log(variance / noise))
        if in_a_row > 0.0:
            continue  # it is left out
        for j in range(n):
            state[j] += seen[j] * miss / variance
            for k in range(n):
                covariance[j, k] -= seen[j] * seen[k] / variance
    for of in range(rates.shape[0]):
        at = 3 + 6 * waves + of
        state[at] = min(max(state[at], bounds[of, 0]), bounds[of, 1])
    return surprise, in_a_row


@compiled
def _unlikely(state: Array, waves: Array) -> float:
    """What is added to a filter's surprise for its waves' sizes."""
    added, first = 0.0, 0.0
    for k in range(waves.shape[0]):
        size = 0.0
        for j in range(3 + 6 * k, 9 + 6 * k):
            size += state[j] * state[j]
        if waves[k, 1] == 1.0:
            first = size
        elif size > first:
            added += UNLIKELY
    return added


@compiled
def _seen(state: Array, covariance: Array, waves: int, axis: int, seen: Array) -> tuple[float, float]:
    """What a frame is expected to tell of an axis and its variance; their covariance with the state into `seen`."""
    expected, n = state[axis], state.shape[0]
    for j in range(n):
        seen[j] = covariance[j, axis]
    for k in range(waves):
        s = 3 + 6 * k + axis
        expected += state[s]
        for j in range(n):
            seen[j] += covariance[j, s]
    variance = seen[axis]
    for k in range(waves):
        variance += seen[3 + 6 * k + axis]
    return expected, variance


@compiled
def _carried(states: Array, surprises: Array, waves: Array, span: float, position: Array, velocity: Array) -> None:
    """Position and velocity `span` [s] after the states, by the filter that has been surprised least."""
    best, count = 0, waves.shape[0]
    for each in range(1, states.shape[0]):
        if surprises[each, 0] < surprises[best, 0]:
            best = each
    state = states[best]
    for i in range(3):
        position[i], velocity[i] = state[i], 0.0
    for k in range(count):
        rate = waves[k, 1] * state[3 + 6 * count + int(waves[k, 0])]
        cos, sin = math.cos(rate * span), math.sin(rate * span)
        for i in range(3):
            s, q = state[3 + 6 * k + i], state[6 + 6 * k + i]
            position[i] += cos * s + sin * q
            velocity[i] += rate * (cos * q - sin * s)


def _finite(position: Array) -> Array:
    if not np.isfinite(position).all():
        raise NotFinite(f"target at {position.tolist()} m is not finite")
    return position


def _later(last: Known, time: float) -> float:
    """The time since the last frame [s]."""
    if not time > last.time:
        raise DescriptionError(f"target: a frame of {time:.4f} s is not later than the last one of {last.time:.4f} s")
    return time - last.time
