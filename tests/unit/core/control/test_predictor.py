import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from core.control.predictor import BREATHING, HEARTBEAT, NewestFrame, Waves
from core.errors import DescriptionError, NotFinite

FRAME = 0.025
NOISE = 1e-4
#: Time from a frame until a command that follows it takes effect [s].
LEAD = 0.06


def direction(random) -> np.ndarray:
    vector = random.standard_normal(3)
    return vector / np.linalg.norm(vector)


def target(rate: float, seed: int, heart: float = 0.5e-3, second: float = 0.15, drift: float = 0.05):
    """Return target positions: breathing of 5 mm with a harmonic, and a heartbeat of 1.2 Hz; both vary slowly."""
    random = np.random.default_rng(seed)
    breath, beat, phases = direction(random), direction(random), random.uniform(0.0, 2.0 * np.pi, 4)

    def phase(rate, swing, start, time):
        return 2.0 * np.pi * rate * (time - drift * swing / (2.0 * np.pi) * np.cos(2.0 * np.pi * time / swing)) + start

    def at(time):
        angle, size = phase(rate, 60.0, phases[0], time), 5e-3 * (1.0 + 0.1 * np.sin(time / 7.0 + phases[1]))
        quick, small = phase(1.2, 37.0, phases[2], time), heart * (1.0 + 0.1 * np.sin(time / 5.0 + phases[3]))
        breathing = size * (np.sin(angle) + second * np.cos(2.0 * angle))
        return np.multiply.outer(breathing, breath) + np.multiply.outer(small * np.sin(quick), beat)

    return at


def predicted(predictor, at, duration=40.0, seed=0, lost=()):
    """Return the frames' times, errors (frames,) [m] of the prediction `LEAD` after each frame, and the last state."""
    random, times = np.random.default_rng(seed), FRAME * np.arange(round(duration / FRAME))
    known, errors = predictor.start(at(0.0), 0.0), []
    for time in times[1:]:
        if not any(start < time < end for start, end in lost):
            known = predictor.update(known, at(time) + NOISE * random.standard_normal(3), time)
        errors.append(np.linalg.norm(predictor.at(known, time + LEAD).position - at(time + LEAD)))
    return times[1:], np.array(errors), known


@pytest.mark.parametrize(("rate", "seed"), [(0.15, 1), (0.25, 2), (0.42, 1)])
def test_predictor_finds_the_rates_and_predicts_within_the_frames_noise(rate, seed):
    waves = Waves()

    times, errors, known = predicted(waves, target(rate, seed), seed=seed)

    found = waves.rates(known)
    assert found[0] == pytest.approx(rate, rel=0.08)  # tolerance: the rates drift by 5 %
    assert found[1] == pytest.approx(1.2, rel=0.08)
    settled = errors[times > 15.0]
    # the prediction has a smaller error than a frame without latency would have
    assert np.sqrt(np.mean(settled**2)) < math.sqrt(3.0) * NOISE
    assert settled.max() < 0.5e-3


def test_predictor_does_not_mistake_a_sinusoid_for_a_harmonic_of_half_its_rate():
    waves = Waves()

    _, _, known = predicted(waves, target(0.25, 5, heart=0.0, second=0.0, drift=0.0))

    assert waves.rates(known)[0] == pytest.approx(0.25, rel=0.02)


def test_target_prediction_is_more_accurate_than_the_newest_frame_after_a_few_seconds():
    times, waves, _ = predicted(Waves(), target(0.25, 3))
    _, newest, _ = predicted(NewestFrame(), target(0.25, 3))

    for start, end, part in ((2.0, 6.0, 1.0), (15.0, 40.0, 0.5)):
        within = (times > start) & (times < end)
        assert waves[within].max() < part * newest[within].max()


def test_predicted_velocity_is_the_derivative_of_the_predicted_position():
    waves = Waves()
    _, _, known = predicted(waves, target(0.25, 4), duration=20.0)
    now, step = known.time + 0.03, 1e-5

    difference = (waves.at(known, now + step).position - waves.at(known, now - step).position) / (2.0 * step)

    np.testing.assert_allclose(waves.at(known, now).velocity, difference, rtol=1e-5, atol=1e-9)


def test_target_prediction_bridges_a_second_without_frames():
    """During a second without frames the prediction stays accurate; the newest frame alone is off by millimetres."""
    gap = (25.0, 26.0)
    times, waves, _ = predicted(Waves(), target(0.25, 6), lost=[gap])
    _, newest, _ = predicted(NewestFrame(), target(0.25, 6), lost=[gap])

    blind = (times > gap[0]) & (times < gap[1])
    assert waves[blind].max() < 1e-3
    assert newest[blind].max() > 2e-3


def test_predictor_finds_a_moved_target_again():
    before = target(0.25, 7)

    def at(time):
        return before(time) + (0.01 if time > 20.0 else 0.0)

    times, errors, _ = predicted(Waves(), at)

    # a single frame after the jump does not move the prediction
    assert errors[(times > 20.0) & (times < 20.1)].max() > 5e-3
    assert errors[(times > 22.0) & (times < 25.0)].max() < 2e-3
    assert errors[times > 35.0].max() < 0.6e-3


def test_predictor_rejects_a_single_outlier_frame():
    calm = target(0.25, 8)

    def at(time):
        return calm(time) + (0.02 if 20.0 < time < 20.03 else 0.0)

    times, errors, _ = predicted(Waves(), at)

    assert errors[times > 20.2].max() < 0.5e-3


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("predictor", [Waves(), NewestFrame()])
def test_predictor_refuses_a_target_frame_that_is_not_finite(predictor, bad):
    known = predictor.start(np.zeros(3), 0.0)

    with pytest.raises(NotFinite):
        predictor.update(known, np.array([0.0, bad, 0.0]), FRAME)
    with pytest.raises(NotFinite):
        predictor.start(np.array([bad, 0.0, 0.0]), 0.0)


@pytest.mark.parametrize("predictor", [Waves(), NewestFrame()])
def test_predictor_refuses_a_frame_that_is_not_later_than_the_last(predictor):
    known = predictor.start(np.zeros(3), 1.0)

    with pytest.raises(DescriptionError, match="must be later than"):
        predictor.update(known, np.zeros(3), 1.0)


def test_predictor_refuses_rhythm_rates_outside_their_bounds():
    with pytest.raises(DescriptionError, match="within bounds"):
        Waves(rhythms=(BREATHING._replace(rates=(0.01,)),))
    with pytest.raises(DescriptionError, match="noise 0"):
        Waves(noise=0.0)


def test_single_predictor_filter_equals_filterpys_extended_kalman_filter():
    rhythms = (BREATHING._replace(rates=(0.25,)), HEARTBEAT._replace(rates=(1.2,)))
    waves, at = Waves(rhythms=rhythms), target(0.25, 9)
    listed, n = [(0, 1.0), (0, 2.0), (1, 1.0)], 3 + 6 * 3 + 2
    known = waves.start(at(0.0), 0.0)
    theirs = ExtendedKalmanFilter(dim_x=n, dim_z=3)
    theirs.x, theirs.P, theirs.R = known.states[0].copy(), known.covariances[0].copy(), NOISE**2 * np.eye(3)
    seen = np.hstack([np.eye(3), *[np.hstack([np.eye(3), np.zeros((3, 3))])] * 3, np.zeros((3, 2))])

    for time in FRAME * np.arange(1, 400):
        frame = at(time) + NOISE * np.random.default_rng(round(time / FRAME)).standard_normal(3)
        known = waves.update(known, frame, float(time))
        _predict(theirs, listed, waves)
        theirs.update(frame, lambda _: seen, lambda x: seen @ x)

    np.testing.assert_allclose(known.states[0], theirs.x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(known.covariances[0], theirs.P, rtol=1e-5, atol=1e-14)


def _predict(theirs: ExtendedKalmanFilter, listed, waves: Waves) -> None:
    """Do the prediction step of the predictor's model with filterpy's matrices."""
    turn = 2.0 * math.pi
    drifts = [waves.centre_drift**2] * 3 + [waves.floor**2] * 18 + [(turn * waves.rate_drift) ** 2] * 2
    theirs.P = theirs.P + FRAME * np.diag(drifts)
    transition, new = np.eye(theirs.x.size), theirs.x.copy()
    for k, (of, multiple) in enumerate(listed):
        s, q, rate = slice(3 + 6 * k, 6 + 6 * k), slice(6 + 6 * k, 9 + 6 * k), 21 + of
        angle = multiple * FRAME * theirs.x[rate]
        new[s] = math.cos(angle) * theirs.x[s] + math.sin(angle) * theirs.x[q]
        new[q] = math.cos(angle) * theirs.x[q] - math.sin(angle) * theirs.x[s]
        transition[s, s] = transition[q, q] = math.cos(angle) * np.eye(3)
        transition[s, q], transition[q, s] = math.sin(angle) * np.eye(3), -math.sin(angle) * np.eye(3)
        transition[s, rate], transition[q, rate] = multiple * FRAME * new[q], -multiple * FRAME * new[s]
    theirs.x, theirs.P = new, transition @ theirs.P @ transition.T
    for k in range(3):
        wave = np.arange(3 + 6 * k, 9 + 6 * k)
        theirs.P[wave, wave] += FRAME * waves.wave_drift**2 * np.sum(new[wave] ** 2) / 3.0
