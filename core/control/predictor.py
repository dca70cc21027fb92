"""Prediction of a target that moves with breathing and heartbeat, from delayed tracker frames at a low rate.

The target's position is modelled on each axis as a constant c and a few waves s_k with quadrature components q_k,

    x(t) = c + sum_k s_k(t),    s_k' = k w q_k,    q_k' = -k w s_k,

where k = 1, 2, ... counts the harmonics of each rhythm, and the rhythm's rate w [rad/s] is the same for all axes. An
extended Kalman filter estimates c, s, q and w; the process noise sets how fast each of these values may drift. The
estimate of a rate converges only from a nearby initial value. Therefore several filters start at several rates, and the
filter with the highest likelihood predicts the target. The waves extrapolate the estimate to any later time; an
extrapolation costs a few sines.
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

#: Number of outlier frames in a row after which the filter restarts at their position, because the target has moved.
REACQUIRE_FRAMES = 8
#: Time constant with which old frames lose weight in the likelihoods that compare the filters [s].
LIKELIHOOD_MEMORY_S = 4.0
#: Cost (negative log likelihood) per frame for each harmonic that is larger than its fundamental. A filter at half the
#: true rate fits equally well with its second harmonic; this cost makes the predictor use the filter at the true rate.
HARMONIC_PENALTY = 0.05


class TargetState(NamedTuple):
    """Position and velocity of a target at one time."""

    position: Array  #: (3,) position of the target [m]
    velocity: Array  #: (3,) velocity of the target [m/s]


class PredictorState(NamedTuple):
    """State of a predictor after its newest frame."""

    time: float  #: time of the newest frame [s]
    states: Array  #: (filters, n) constant c (3,) [m], then s and q (3,) of each wave [m], then the rates w [rad/s]
    covariances: Array  #: (filters, n, n) covariances of the states
    costs: Array  #: (filters, 2) negative log likelihood of the frames; number of outlier frames in a row


class Predictor(Protocol):
    """Predicts the target's position at a later time from tracker frames."""

    def start(self, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after a first frame `position` (3,) [m], measured at `time` [s]."""
        ...

    def update(self, last: PredictorState, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after another frame; `time` [s] must be later than that of the last frame."""
        ...

    def at(self, known: PredictorState, time: float) -> TargetState:
        """Return the predicted position and velocity of the target at `time` [s]."""
        ...


@dataclass(frozen=True)
class NewestFrame:
    """Predictor for a target at rest: the prediction is the target's position in the newest tracker frame."""

    def start(self, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after a first frame `position` (3,) [m], measured at `time` [s]."""
        return PredictorState(time, _finite(position)[None].copy(), np.zeros((1, 3, 3)), np.zeros((1, 2)))

    def update(self, last: PredictorState, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after another frame, which must be later than the last frame."""
        _time_since_frame(last, time)
        return self.start(position, time)

    def at(self, known: PredictorState, time: float) -> TargetState:  # noqa: ARG002 - independent of time
        """Return the position in the newest frame, with zero velocity."""
        return TargetState(known.states[0], np.zeros(3))


class Rhythm(NamedTuple):
    """A rhythm of the target, such as breathing: initial values and bounds for the search of its rate."""

    rates: tuple[float, ...]  #: initial values of the rate, one filter each [Hz]
    spread: float  #: initial standard deviation of the rate about each initial value [Hz]
    lowest: float  #: lower bound of the rate [Hz]
    highest: float  #: upper bound of the rate [Hz]
    waves: int  #: number of waves: the fundamental and its harmonics
    size: float  #: initial standard deviation of the fundamental [m]; that of the k-th harmonic is divided by k^2


BREATHING = Rhythm((0.15, 0.25, 0.4), 0.03, 0.08, 0.65, 2, 5e-3)
HEARTBEAT = Rhythm((1.0, 1.5), 0.15, 0.8, 3.0, 1, 1e-3)


@dataclass(frozen=True)
class Waves:
    """Predictor that models the target as a constant position plus the waves of some rhythms."""

    rhythms: tuple[Rhythm, ...] = (BREATHING, HEARTBEAT)
    noise: float = 1e-4  #: standard deviation of a tracker frame in each axis [m]
    centre_drift: float = 2e-4  #: random walk of the constant position [m/s^0.5]
    wave_drift: float = 0.03  #: random walk of every wave, as a fraction of the wave's size [1/s^0.5]
    floor: float = 2e-5  #: random walk of a wave of size 0 [m/s^0.5]
    rate_drift: float = 0.006  #: random walk of every rhythm's rate [Hz/s^0.5]
    gate: float = 8.0  #: measured minus expected position beyond which a frame is an outlier [standard deviations]

    def __post_init__(self) -> None:
        for name in ("noise", "centre_drift", "wave_drift", "floor", "rate_drift", "gate"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise DescriptionError(f"waves: {name} {getattr(self, name):g} must be finite and greater than 0")
        for rhythm in self.rhythms:
            wrong = [rate for rate in rhythm.rates if not 0.0 < rhythm.lowest <= rate <= rhythm.highest < math.inf]
            if wrong or not rhythm.rates or rhythm.waves < 1:
                raise DescriptionError(
                    f"waves: a rhythm has {rhythm.waves} waves, rates {rhythm.rates} Hz, bounds {rhythm.lowest:g} ..."
                    f" {rhythm.highest:g} Hz; give at least one wave, and rates within bounds above 0 Hz"
                )

    @cached_property
    def _waves(self) -> Array:
        """Index of the rhythm and number of the harmonic for each wave (waves, 2)."""
        listed = [(of, k + 1) for of, rhythm in enumerate(self.rhythms) for k in range(rhythm.waves)]
        return np.array(listed, dtype=np.float64).reshape(-1, 2)

    @cached_property
    def _first(self) -> tuple[Array, Array]:
        """Initial rates of each filter (filters, rhythms) [rad/s], and initial variance of each state variable."""
        turn = 2.0 * math.pi
        rates = np.array(list(itertools.product(*(rhythm.rates for rhythm in self.rhythms))))
        spreads = np.array([(turn * rhythm.spread) ** 2 for rhythm in self.rhythms])
        waves = np.repeat([(self.rhythms[int(of)].size / k**2) ** 2 for of, k in self._waves], 6)
        return turn * rates, np.concatenate((np.full(3, self.noise**2 + waves[:1].sum()), waves, spreads))

    @cached_property
    def _settings(self) -> tuple[Array, Array, Array]:
        """Array `_waves`; process noise per second of each state variable; bounds of the rates (rhythms, 2) [rad/s]."""
        turn = 2.0 * math.pi
        drifts = np.concatenate(
            (
                np.full(3, self.centre_drift**2), np.full(6 * len(self._waves), self.floor**2),
                np.full(len(self.rhythms), (turn * self.rate_drift) ** 2),
            )
        )  # fmt: skip
        bounds = turn * np.array([(rhythm.lowest, rhythm.highest) for rhythm in self.rhythms]).reshape(-1, 2)
        return self._waves, drifts, bounds

    def start(self, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after a first frame `position` (3,) [m], measured at `time` [s]."""
        rates, variances = self._first
        still = np.concatenate((_finite(position), np.zeros(6 * len(self._waves))))
        states = np.concatenate((np.tile(still, (len(rates), 1)), rates), axis=1)
        return PredictorState(time, states, np.tile(np.diag(variances), (len(rates), 1, 1)), np.zeros((len(rates), 2)))

    def update(self, last: PredictorState, position: Array, time: float) -> PredictorState:
        """Return the predictor's state after another frame.

        Raises:
            NotFinite: the frame is not finite; a NaN would stay in the filter forever.
            DescriptionError: the frame is not later than the last frame.
        """
        now = PredictorState(time, last.states.copy(), last.covariances.copy(), last.costs.copy())
        _update(
            *now[1:], *self._settings, *self._first, _finite(position), _time_since_frame(last, time),
            self.noise**2, self.wave_drift**2, self.gate,
        )  # fmt: skip
        return now

    def at(self, known: PredictorState, time: float) -> TargetState:
        """Return the target's position and velocity at `time` [s], extrapolated by the waves."""
        target = TargetState(np.empty(3), np.empty(3))
        _predicted(known.states, known.costs, self._waves, time - known.time, *target)
        return target

    def rates(self, known: PredictorState) -> Array:
        """Return the estimated rate of each rhythm (rhythms,) [Hz]."""
        best = known.states[known.costs[:, 0].argmin()]
        return best[3 + 6 * len(self._waves) :] / (2.0 * math.pi)


@compiled
def _update(
    states: Array, covariances: Array, costs: Array, waves: Array, drifts: Array, bounds: Array,
    rates: Array, variances: Array, position: Array, span: float, noise: float, wave_noise: float, gate: float,
) -> None:  # fmt: skip
    """Update the state of every filter in place with a frame that was measured `span` [s] after the last one."""
    decay = math.exp(-span / LIKELIHOOD_MEMORY_S)
    for each in range(states.shape[0]):
        _advance(states[each], covariances[each], waves, drifts, wave_noise, span)
        cost, in_a_row = _correct(
            states[each], covariances[each], waves.shape[0], bounds, rates[each], variances,
            position, noise, gate, costs[each, 1],
        )  # fmt: skip
        costs[each, 0] = decay * costs[each, 0] + cost + _harmonic_penalty(states[each], waves)
        costs[each, 1] = in_a_row


@compiled
def _advance(state: Array, covariance: Array, waves: Array, drifts: Array, wave_noise: float, span: float) -> None:
    """Advance a filter's state and covariance in place by `span` [s]."""
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
            # Covariance F P F^T with transition matrix F, two rows and columns at a time. F does not change the rates.
            to_s, to_q = turn * state[q], -turn * state[s]
            for j in range(n):
                a, b, w = covariance[s, j], covariance[q, j], covariance[rate, j]
                covariance[s, j], covariance[q, j] = cos * a + sin * b + to_s * w, cos * b - sin * a + to_q * w
            for j in range(n):
                a, b, w = covariance[j, s], covariance[j, q], covariance[j, rate]
                covariance[j, s], covariance[j, q] = cos * a + sin * b + to_s * w, cos * b - sin * a + to_q * w
        for j in range(3 + 6 * k, 9 + 6 * k):
            covariance[j, j] += span * wave_noise * size / 3.0


@compiled
def _correct(
    state: Array, covariance: Array, waves: int, bounds: Array, rates: Array, variances: Array,
    position: Array, noise: float, gate: float, in_a_row: float,
) -> tuple[float, float]:  # fmt: skip
    """Correct a filter's state and covariance in place with one frame.

    Return the frame's negative log likelihood and the number of outliers in a row.
    """
    n, cross, cost, off = state.shape[0], np.empty(state.shape[0]), 0.0, False
    for i in range(3):
        expected, variance = _expected_measurement(state, covariance, waves, i, cross)
        off = off or (position[i] - expected) ** 2 > gate**2 * (variance + noise)
    in_a_row = in_a_row + 1.0 if off else 0.0
    if in_a_row >= REACQUIRE_FRAMES:
        # Restart the filter from the initial covariance and rates, at the target's present position.
        for j in range(n):
            for k in range(n):
                covariance[j, k] = 0.0
            covariance[j, j] = variances[j]
        for of in range(rates.shape[0]):
            state[3 + 6 * waves + of] = rates[of]
        for i in range(3):
            expected, variance = _expected_measurement(state, covariance, waves, i, cross)
            state[i] += position[i] - expected
        in_a_row = 0.0
    for i in range(3):
        expected, variance = _expected_measurement(state, covariance, waves, i, cross)
        variance += noise
        miss = position[i] - expected
        cost += 0.5 * (miss * miss / variance + math.log(variance / noise))
        if in_a_row > 0.0:
            continue  # an outlier does not correct the state
        for j in range(n):
            state[j] += cross[j] * miss / variance
            for k in range(n):
                covariance[j, k] -= cross[j] * cross[k] / variance
    for of in range(rates.shape[0]):
        at = 3 + 6 * waves + of
        state[at] = min(max(state[at], bounds[of, 0]), bounds[of, 1])
    return cost, in_a_row


@compiled
def _harmonic_penalty(state: Array, waves: Array) -> float:
    """Return the additional cost of a filter: `HARMONIC_PENALTY` for each harmonic larger than its fundamental."""
    added, first = 0.0, 0.0
    for k in range(waves.shape[0]):
        size = 0.0
        for j in range(3 + 6 * k, 9 + 6 * k):
            size += state[j] * state[j]
        if waves[k, 1] == 1.0:
            first = size
        elif size > first:
            added += HARMONIC_PENALTY
    return added


@compiled
def _expected_measurement(state: Array, covariance: Array, waves: int, axis: int, cross: Array) -> tuple[float, float]:
    """Return the expected position on one axis and its variance; write its covariance with the state to `cross`."""
    expected, n = state[axis], state.shape[0]
    for j in range(n):
        cross[j] = covariance[j, axis]
    for k in range(waves):
        s = 3 + 6 * k + axis
        expected += state[s]
        for j in range(n):
            cross[j] += covariance[j, s]
    variance = cross[axis]
    for k in range(waves):
        variance += cross[3 + 6 * k + axis]
    return expected, variance


@compiled
def _predicted(states: Array, costs: Array, waves: Array, span: float, position: Array, velocity: Array) -> None:
    """Predict the target `span` [s] after the newest frame, with the filter of the highest likelihood.

    Write the result to `position` and `velocity`.
    """
    best, count = 0, waves.shape[0]
    for each in range(1, states.shape[0]):
        if costs[each, 0] < costs[best, 0]:
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


def _time_since_frame(last: PredictorState, time: float) -> float:
    """Return the time from the last frame until `time` [s]; raise DescriptionError if `time` is not later."""
    if not time > last.time:
        raise DescriptionError(f"target: the frame at {time:.4f} s must be later than the last one, {last.time:.4f} s")
    return time - last.time
