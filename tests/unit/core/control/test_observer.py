"""The tip between tracker frames: unbiased, in time, honest about what it does not know."""

import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from core.control.observer import Observer
from core.errors import DescriptionError, NotFinite

PERIOD, FRAME, LATENCY = 0.002, 0.025, 0.024


class Bench:
    """A moving tip, a model with a bias, and a tracker."""

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


def test_a_constant_bias_is_found_however_the_robot_moves():
    """At 20 mm/s a latency of 24 ms is half a millimetre: compared with the wrong moment it would stay."""
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT)
    bench.seen = bench.observer.start(bench.model(0.0), bench.model(0.0))  # told nothing of the bias

    bench.run(5.0)

    np.testing.assert_allclose(bench.error, 0.0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.bias, CONSTANT, rtol=0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.drift, 0.0, atol=1e-5)


def test_a_bias_that_grows_steadily_is_followed_without_lag_and_its_rate_is_the_drift():
    slope = np.array([3e-4, 0.0, -1e-4])
    bench = Bench(Observer(PERIOD), lambda time: slope * time)

    bench.run(8.0)

    np.testing.assert_allclose(bench.error, 0.0, atol=2e-6)
    np.testing.assert_allclose(bench.seen.drift, slope, rtol=0, atol=5e-6)


def test_the_uncertainty_is_the_spread_of_the_error():
    errors, said = [], []
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT, noise=1e-4)
    bench.run(4.0)
    for _ in range(600):
        bench.run(0.05)
        errors.append(bench.error)
        said.append(bench.seen.uncertainty)

    spread = np.sqrt(np.mean(np.square(errors)))
    # The filter also allows for a bias that wanders, which this one does not.
    assert 0.3 * np.mean(said) < spread < np.mean(said)
    assert np.mean(said) < 0.9e-4  # better than a frame


def test_the_covariance_settles_at_the_riccati_equations_solution():
    observer = Observer(PERIOD)
    step, noise = FRAME, observer.noise**2
    transition = np.array([[1.0, step], [0.0, 1.0]])
    process = observer.wander * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]])
    see = np.array([[1.0, 0.0]])
    before = solve_discrete_are(transition.T, see.T, process, np.array([[noise]]))
    after = before - before @ see.T @ see @ before / (before[0, 0] + noise)
    seen = observer.start(np.zeros(3), np.zeros(3))

    # Frames without latency, every 25 ms on average: ticks 12 and 13 apart.
    for tick in range(1, 10_001):
        frame = tick % 25 in (0, 12)
        seen = observer.update(seen, np.zeros(3), np.zeros(3) if frame else None, 0.0)

    assert seen.covariance[0] == pytest.approx(after[0, 0], rel=0.05)
    assert seen.covariance[2] == pytest.approx(after[1, 1], rel=0.05)


def test_in_a_drop_out_the_model_carries_on_and_the_uncertainty_grows():
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT)
    before = bench.run(5.0).uncertainty
    grown = [before, *(bench.run(0.25, blind=True).uncertainty for _ in range(8))]

    assert np.all(np.diff(grown) > 0.0)
    assert grown[-1] > 10.0 * before
    np.testing.assert_allclose(bench.error, 0.0, atol=1e-5)  # 40 mm further on
    bench.run(1.0)
    assert bench.seen.uncertainty < 2.0 * before


def test_a_jump_is_left_out_and_believed_when_it_stays():
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
    bench.run(0.5)  # twenty frames that agree
    assert bench.error[0] == pytest.approx(5e-3, abs=5e-4)


def test_frames_that_jump_each_elsewhere_are_never_believed():
    bench = Bench(Observer(PERIOD), lambda _: CONSTANT, noise=1e-4)
    bench.run(5.0)
    for place in range(10):
        bench.jump = np.array([5e-3 * (-1) ** place, 0.0, 0.0])
        bench.run(0.025)
    assert not bench.seen.used
    assert abs(bench.error[0]) < 1e-3


def test_a_frame_older_than_the_history_is_left_out():
    observer = Observer(PERIOD, longest_age=0.1)
    seen = observer.start(np.zeros(3), np.zeros(3))

    after = observer.update(seen, np.zeros(3), np.full(3, 1e-3), 0.2)

    assert not after.used
    assert after.bias.tolist() == [0.0, 0.0, 0.0]


def test_it_does_not_change_what_it_is_given():
    observer = Observer(PERIOD)
    seen = observer.start(np.zeros(3), CONSTANT)
    kept = [part.copy() for part in seen[:2]]

    observer.update(seen, np.ones(3), np.ones(3), 0.024)

    for part, copy in zip(seen[:2], kept, strict=True):
        np.testing.assert_array_equal(part, copy)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_frame_that_is_not_finite_is_refused(bad):
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
def test_an_impossible_observer_is_refused_by_name_value_and_unit(change, words):
    with pytest.raises(DescriptionError) as refused:
        Observer(**{"period": PERIOD, **change})

    assert words in str(refused.value)
