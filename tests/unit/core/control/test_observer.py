"""The filters of a tick are unbiased and report a correct uncertainty; tracker frames give the load's tip velocity."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_discrete_are

from core.control.observer import (
    FARTHEST_M,
    LONGEST_S,
    NO_FRAMES,
    USUAL_GAINS,
    Observer,
    RateFilter,
    differentiate,
    steady_gain,
)
from core.errors import DescriptionError, NotFinite

PERIOD = 0.002


def noise(period: float, bandwidth: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix and process noise of a constant-velocity model; its measurement noise is 1."""
    density = (2.0 * math.pi * bandwidth) ** 4 * period
    shaken = np.array([[period**3 / 3.0, period**2 / 2.0], [period**2 / 2.0, period]])
    return np.array([[1.0, period], [0.0, 1.0]]), density * shaken


def test_steady_rate_filter_equals_the_full_kalman_recursion_once_settled():
    random, axes, start = np.random.default_rng(31), 3, np.array([1e-3, -2e-3, 0.0])
    recursions = []
    for axis in range(axes):
        kalman = KalmanFilter(dim_x=2, dim_z=1)
        kalman.F, kalman.Q = noise(PERIOD, 2.0)
        kalman.H, kalman.P = np.array([[1.0, 0.0]]), np.diag([1.0, 100.0])
        kalman.x = np.array([[start[axis]], [0.0]])
        recursions.append(kalman)
    steady = RateFilter(PERIOD, 2.0)
    estimate = steady.start(start)

    for tick in range(2000):
        measured = 0.01 * np.sin(2.0 * tick * PERIOD + np.arange(3)) + random.normal(scale=1e-4, size=3)
        estimate = steady.update(estimate, measured)
        for kalman, value in zip(recursions, measured, strict=True):
            kalman.predict()
            kalman.update(value)

    full = np.array([kalman.x[:, 0] for kalman in recursions])
    assert np.abs(full[:, 1]).max() > 1e-3  # the test case has a rate that is not zero
    np.testing.assert_allclose(estimate.value, full[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.rate, full[:, 1], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("period", "bandwidth"), [(0.002, 0.5), (0.002, 100.0), (0.025, 1.0)])
def test_the_rate_filters_gain_solves_the_riccati_equation(period, bandwidth):
    transition, process = noise(period, bandwidth)
    observe = np.array([[1.0, 0.0]])
    covariance = solve_discrete_are(transition.T, observe.T, process, np.eye(1))
    expected = covariance[:, 0] / (covariance[0, 0] + 1.0)

    np.testing.assert_allclose(RateFilter(period, bandwidth).gain, expected, rtol=1e-6)


@pytest.mark.parametrize(("period", "bandwidth"), USUAL_GAINS)
def test_the_stored_gains_are_those_of_filterpys_recursion(period, bandwidth):
    np.testing.assert_allclose(USUAL_GAINS[period, bandwidth], steady_gain(period, bandwidth), rtol=1e-12)


def test_rate_filter_follows_a_ramp_without_error_once_settled():
    slope, steady = np.array([0.01, -0.02, 0.0]), RateFilter(PERIOD)
    estimate = steady.start(np.zeros(3))

    for tick in range(1, 5001):
        estimate = steady.update(estimate, slope * (tick * PERIOD))

    np.testing.assert_allclose(estimate.rate, slope, rtol=0, atol=1e-10)
    np.testing.assert_allclose(estimate.value, slope * 10.0, rtol=0, atol=1e-10)


def test_rate_filter_starts_at_rest_and_stays_at_rest_for_a_constant_input():
    steady, here = RateFilter(PERIOD), np.array([1.0, 2.0, 3.0])

    estimate = steady.update(steady.start(here), here)

    assert estimate.value.tolist() == [1.0, 2.0, 3.0]
    assert estimate.rate.tolist() == [0.0, 0.0, 0.0]


def test_rate_filter_extrapolates_at_the_last_rate_without_a_measurement():
    steady = RateFilter(PERIOD)
    moving = steady.update(steady.start(np.zeros(3)), np.array([1e-3, 0.0, -1e-3]))

    coasted = moving
    for _ in range(10):
        coasted = steady.update(coasted, None)

    np.testing.assert_array_equal(coasted.rate, moving.rate)
    np.testing.assert_allclose(coasted.value, moving.value + 10 * PERIOD * moving.rate, rtol=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_rate_filter_refuses_a_measurement_that_is_not_finite(bad):
    steady = RateFilter(PERIOD)

    with pytest.raises(NotFinite, match=rf"deflection .*{bad}.* m is not finite"):
        steady.update(steady.start(np.zeros(3)), np.array([0.0, bad, 0.0]))
    with pytest.raises(NotFinite, match=rf"deflection .*{bad}.* m is not finite"):
        steady.start(np.array([0.0, bad, 0.0]))


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, 250.0, math.nan, math.inf])
def test_rate_filter_refuses_a_bandwidth_outside_zero_to_nyquist(bandwidth):
    with pytest.raises(DescriptionError, match=rf"bandwidth {bandwidth:g} Hz is outside 0 \.\.\. 250 Hz"):
        RateFilter(PERIOD, bandwidth)


@pytest.mark.parametrize("period", [0.0, -0.002, math.nan, math.inf])
def test_rate_filter_refuses_an_invalid_period(period):
    with pytest.raises(DescriptionError, match=rf"period {period:g} s must be finite and greater than 0"):
        RateFilter(period)


FRAME, LATENCY = 0.025, 0.024


class Bench:
    """Simulation of a moving tip, a model with a bias, and a tracker."""

    def __init__(self, observer: Observer, bias, noise: float = 0.0, speed: float = 0.02) -> None:
        self.observer, self.bias, self.noise, self.speed = observer, bias, noise, speed
        self.random = np.random.default_rng(7)
        self.tick, self.frames = 0, 0
        self.seen = observer.start(self.model(0.0), self.true(0.0))
        self.jump = np.zeros(3)

    def model(self, time: float) -> np.ndarray:
        return np.array([self.speed * math.sin(time), self.speed * time, 0.0])

    def true(self, time: float) -> np.ndarray:
        return self.model(time) + self.bias(time)

    @property
    def time(self) -> float:
        return self.tick * PERIOD

    def run(self, seconds: float, blind: bool = False):
        for _ in range(round(seconds / PERIOD)):
            self.tick += 1
            tip, age = None, 0.0
            while self.frames * FRAME + LATENCY <= self.time + 1e-9:
                taken = self.frames * FRAME
                tip, age = self.true(taken) + self.noise * self.random.normal(size=3) + self.jump, self.time - taken
                self.frames += 1
            self.seen = self.observer.update(self.seen, self.model(self.time), None if blind else tip, age)
        return self.seen

    @property
    def error(self) -> np.ndarray:
        return self.seen.tip - self.true(self.time)


CONSTANT = np.array([1e-3, -2e-3, 0.5e-3])


def test_observer_finds_a_constant_model_bias_during_any_motion_of_the_robot():
    """A frame compared at the wrong time would cause an error: 24 ms of latency at 20 mm/s are half a millimetre."""
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT)
    # the observer starts with an estimate of zero bias
    bench.seen = bench.observer.start(bench.model(0.0), bench.model(0.0))

    bench.run(5.0)

    np.testing.assert_allclose(bench.error, 0.0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.bias, CONSTANT, rtol=0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.drift, 0.0, atol=1e-5)


def test_observer_follows_a_steadily_growing_bias_without_lag_and_drift_is_its_rate():
    slope = np.array([3e-4, 0.0, -1e-4])
    bench = Bench(Observer(PERIOD), lambda time: slope * time)

    bench.run(8.0)

    np.testing.assert_allclose(bench.error, 0.0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.drift, slope, rtol=0, atol=5e-6)


def test_the_observers_uncertainty_matches_the_spread_of_its_error():
    errors, uncertainties = [], []
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT, noise=1e-4)
    bench.run(4.0)
    for _ in range(200):
        bench.run(0.05)
        errors.append(bench.error)
        uncertainties.append(bench.seen.uncertainty)

    spread = np.sqrt(np.mean(np.square(errors)))
    # The filter assumes a random walk of the bias, which the simulated bias does not have: the uncertainty is larger.
    assert 0.3 * np.mean(uncertainties) < spread < np.mean(uncertainties)
    assert np.mean(uncertainties) < 0.9e-4  # smaller than the noise of a single frame


def test_the_observers_covariance_settles_at_the_solution_of_the_riccati_equation():
    observer = Observer(PERIOD)
    step, noise = FRAME, observer.noise**2
    transition = np.array([[1.0, step], [0.0, 1.0]])
    process = observer.wander * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    see = np.array([[1.0, 0.0]])
    before = solve_discrete_are(transition.T, see.T, process, np.array([[noise]]))
    after = before - before @ see.T @ see @ before / (before[0, 0] + noise)
    seen = observer.start(np.zeros(3), np.zeros(3))

    # Frames without latency arrive every 25 ms on average, i.e. alternately 12 and 13 ticks apart.
    for tick in range(1, 10_001):
        frame = tick % 25 in (0, 12)
        seen = observer.update(seen, np.zeros(3), np.zeros(3) if frame else None, 0.0)

    assert seen.covariance[0] == pytest.approx(after[0, 0], rel=0.05)
    assert seen.covariance[2] == pytest.approx(after[1, 1], rel=0.05)


def test_observed_tip_follows_the_model_in_a_tracker_drop_out_and_its_uncertainty_grows():
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT)
    before = bench.run(5.0).uncertainty
    grown = [before, *(bench.run(0.25, blind=True).uncertainty for _ in range(8))]

    assert np.all(np.diff(grown) > 0.0)
    assert grown[-1] > 10.0 * before
    np.testing.assert_allclose(bench.error, 0.0, atol=1e-5)  # the tip has moved on by 40 mm meanwhile
    bench.run(1.0)
    assert bench.seen.uncertainty < 2.0 * before


@pytest.mark.parametrize(("speed", "distance"), [(4e-3, 4e-3 * LONGEST_S), (0.02, FARTHEST_M)])
def test_a_bias_that_grows_is_extrapolated_for_a_bounded_time_and_distance(speed, distance):
    bench = Bench(Observer(PERIOD), lambda time: np.array([speed * time, 0.0, 0.0]))
    used = bench.run(5.0).bias[0]
    ends = [bench.run(0.5, blind=True).bias[0] for _ in range(4)]

    # The newest frame that was used is younger than a period of the tracker.
    assert ends[0] - used == pytest.approx(distance, abs=1.1 * FRAME * speed)
    assert ends == [ends[0]] * 4
    assert bench.seen.drift.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("noise", [1e-3, 3e-3, 1e-2])
def test_frames_with_more_noise_than_expected_do_not_move_the_estimate_far_from_the_true_tip(noise):
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT)
    bench.run(2.0)
    bench.noise = noise
    farthest = 0.0
    for _ in range(800):
        bench.run(0.05)
        farthest = max(farthest, float(np.linalg.norm(bench.error)))
    assert farthest < 3.0 * noise + 2.0 * FARTHEST_M


def test_observer_rejects_a_jump_of_the_tip_and_accepts_it_when_it_lasts():
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT, noise=1e-4)
    bench.run(5.0)
    bench.jump = np.array([5e-3, 0.0, 0.0])
    bench.run(0.1)
    assert not bench.seen.used
    assert abs(bench.error[0]) < 3e-4
    bench.jump = np.zeros(3)
    bench.run(1.0)
    np.testing.assert_allclose(bench.error, 0.0, atol=2e-4)

    bench.jump = np.array([5e-3, 0.0, 0.0])
    bench.run(0.5)  # 20 frames that agree with each other
    assert bench.error[0] == pytest.approx(5e-3, abs=5e-4)


def test_observer_accepts_frames_that_agree_although_its_own_extrapolation_moves_away_from_them():
    bench = Bench(Observer(PERIOD), lambda time: np.array([0.04 * min(time, 2.0), 0.0, 0.0]), noise=1e-5)
    bench.run(2.0)
    bench.jump = np.array([-2e-3, 0.0, 0.0])
    bench.run(0.1)

    assert bench.error[0] == pytest.approx(-2e-3, abs=5e-4)
    assert abs(bench.seen.drift[0]) < 5e-3


def test_observer_never_accepts_outlier_frames_that_disagree_with_each_other():
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT, noise=1e-4)
    bench.run(5.0)
    for place in range(10):
        bench.jump = np.array([5e-3 * (-1) ** place, 0.0, 0.0])
        bench.run(0.025)
    assert not bench.seen.used
    assert abs(bench.error[0]) < 1e-3


def test_observer_rejects_a_frame_older_than_its_history():
    observer = Observer(PERIOD, longest_age=0.1)
    seen = observer.start(np.zeros(3), np.zeros(3))

    after = observer.update(seen, np.zeros(3), np.full(3, 1e-3), 0.2)

    assert not after.used
    assert after.bias.tolist() == [0.0, 0.0, 0.0]


def test_observer_does_not_change_its_arguments():
    observer = Observer(PERIOD)
    seen = observer.start(np.zeros(3), CONSTANT)
    kept = [part.copy() for part in seen[:2]]

    observer.update(seen, np.ones(3), np.ones(3), 0.024)

    for part, copy in zip(seen[:2], kept, strict=True):
        np.testing.assert_array_equal(part, copy)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_observer_refuses_a_frame_that_is_not_finite(bad):
    observer = Observer(PERIOD)
    with pytest.raises(NotFinite, match=rf"measured tip .*{bad}.* m is not finite"):
        observer.update(observer.start(np.zeros(3), np.zeros(3)), np.zeros(3), np.array([0.0, bad, 0.0]), 0.0)
    with pytest.raises(NotFinite):
        observer.start(np.zeros(3), np.array([0.0, bad, 0.0]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"period": 0.0}, "period 0 s"),
        ({"noise": -1.0}, "noise -1 m"),
        ({"bandwidth": math.nan}, "bandwidth nan Hz"),
        ({"gate": 0.0}, "gate 0 standard deviations"),
        ({"longest_age": math.inf}, "longest_age inf s"),
    ],
)
def test_invalid_observer_settings_are_refused_by_name_value_and_unit(change, words):
    with pytest.raises(DescriptionError) as refused:
        Observer(**{"period": PERIOD, **change})

    assert words in str(refused.value)


def velocities(places, times, ages, ticks, by_joints=0.0):
    """Return the velocities along x at each tick, while the joints move the tip at `by_joints` [m/s].

    Frame k has the position `places[k]` [m] along x, is measured at `times[k]` [s] and arrives `ages[k]` [s] later.
    """
    seen, tip, found, waiting = NO_FRAMES, np.zeros(3), [], list(zip(places, times, ages, strict=True))
    for number in range(1, ticks + 1):
        now, frame, age = number * PERIOD, None, 0.0
        if waiting and now >= waiting[0][1] + waiting[0][2] - 1e-9:
            place, taken, _ = waiting.pop(0)
            frame, age = np.array([place, 0.0, 0.0]), now - taken
        seen = differentiate(seen, np.array([by_joints, 0.0, 0.0]), tip, frame, age, PERIOD)
        tip = tip if frame is None else frame
        found.append(seen.velocity[0])
    return found


def test_constant_tip_velocity_is_found_from_frames_with_any_latency():
    times = 0.026 * np.arange(1, 5)
    found = velocities(0.01 * times, times, [0.0, 0.010, 0.002, 0.014], 70)
    assert found[-1] == pytest.approx(0.01)
    assert {round(one, 9) for one in found} == {0.0, 0.01}


def test_tip_motion_caused_by_the_joints_is_not_attributed_to_the_load():
    times = 0.026 * np.arange(1, 5)
    found = velocities(0.01 * times, times, [0.0] * 4, 70, by_joints=0.01)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_tracker_velocity_is_constant_between_frames_and_has_their_noise_over_the_interval():
    found = velocities([0.0, 1e-4], [0.026, 0.050], [0.0, 0.0], 60)
    assert found[23] == 0.0
    assert found[24] == found[-1] == pytest.approx(1e-4 / 0.024)


def test_repeated_tracker_frame_does_not_change_the_tip_velocity():
    seen = differentiate(NO_FRAMES, np.zeros(3), np.zeros(3), np.array([1e-3, 0.0, 0.0]), 0.0, PERIOD)
    again = differentiate(seen, np.zeros(3), np.array([1e-3, 0.0, 0.0]), np.array([1e-3, 0.0, 0.0]), PERIOD, PERIOD)
    np.testing.assert_array_equal(again.velocity, seen.velocity)
    assert again.since == pytest.approx(PERIOD)
