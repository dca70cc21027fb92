"""A led tip against what bounded speed and acceleration allow, worked out by hand."""

import math

import numpy as np
import pytest

from core.control.leading import BOUNDS, LedTip, Wish

PERIOD = 0.002
STILL = np.zeros(3)


def follow(tip: LedTip, wish, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Places and velocities (k, 3) of the setpoint; `wish` is asked with the time."""
    setpoints = [tip.advance(PERIOD * k, wish(PERIOD * k), PERIOD) for k in range(round(seconds / PERIOD))]
    return np.array([s.position for s in setpoints]), np.array([s.velocity for s in setpoints])


def norms(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=1)


def kept(velocities: np.ndarray) -> bool:
    """Whether both bounds were, from rest on."""
    changes = np.diff(velocities, axis=0, prepend=0.0)
    return bool((norms(velocities) < 0.020 + 1e-12).all() and (norms(changes) < 0.100 * PERIOD + 1e-12).all())


def test_a_place_that_jumps_is_approached_within_both_bounds_and_met_without_going_beyond():
    place = np.array([0.030, 0.0, 0.0])
    places, velocities = follow(LedTip(BOUNDS), lambda _: Wish(place, STILL, 0.0, 0.1), 3.0)

    assert kept(velocities)
    assert places[:, 0].max() <= 0.030 + 1e-9
    assert places[-1] == pytest.approx(place, abs=1e-7)
    # 1.7 s with the full deceleration: both ramps take 0.2 s and 2 mm
    arrived = PERIOD * np.argmax(places[:, 0] > 0.0299)
    assert 1.6 < arrived < 2.0


def test_a_moving_place_is_followed_without_lag_once_it_is_met():
    velocity = np.array([0.0, 0.010, 0.0])
    places, velocities = follow(LedTip(BOUNDS), lambda t: Wish(velocity * t, velocity, t, 0.1), 2.0)

    assert kept(velocities)
    assert places[-1] == pytest.approx(velocity * 2.0, abs=1e-6)


def test_a_velocity_is_reached_with_the_acceleration_and_ends_before_the_reach():
    velocity = np.array([0.0, 0.0, 0.020])
    places, velocities = follow(LedTip(BOUNDS), lambda t: Wish(None, velocity, t, 0.1), 5.0)

    assert kept(velocities)
    assert PERIOD * (1 + np.argmax(norms(velocities) > 0.020 - 1e-9)) == pytest.approx(0.2, abs=2 * PERIOD)
    assert 0.0499 < places[-1, 2] <= 0.050 + 1e-9


def test_without_a_word_it_comes_to_rest_as_soon_as_it_can():
    tip = LedTip(BOUNDS)
    follow(tip, lambda t: Wish(None, np.array([0.020, 0.0, 0.0]), t, 0.1), 1.0)
    places, _ = follow(tip, lambda _: None, 0.5)

    # speed^2 / (2 a), give or take the way of one period
    assert places[-1, 0] - places[0, 0] == pytest.approx(0.002, abs=2 * 0.020 * PERIOD)
    assert tip.speed == 0.0


def test_a_place_goes_on_by_its_velocity_for_as_long_as_it_was_said():
    velocity = np.array([0.010, 0.0, 0.0])
    places, _ = follow(LedTip(BOUNDS), lambda _: Wish(STILL, velocity, 0.0, 0.5), 3.0)

    assert places[-1, 0] == pytest.approx(0.010 * 0.5, abs=1e-6)


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 500.0])
def test_a_circle_asked_for_piece_by_piece_with_pieces_missing_is_drawn_without_jerk(rate):
    turn = 2.0 * math.pi / 20.0
    rng = np.random.default_rng(7)

    def circle(time: float) -> np.ndarray:
        return 0.010 * np.array([math.cos(turn * time) - 1.0, math.sin(turn * time), 0.0])

    said = [Wish(STILL, STILL, 0.0, 1.0 / rate)]

    def wish(time: float) -> Wish:
        if rate * time >= rate * said[-1].asked + 1.0 - 1e-9 and rng.random() > 0.1:
            place = circle(time)
            said.append(Wish(place, (place - said[-1].place) / (time - said[-1].asked), time, 1.0 / rate))
        return said[-1]

    places, velocities = follow(LedTip(BOUNDS), wish, 20.0)

    assert kept(velocities)
    wanted = np.array([circle(PERIOD * (k + 1)) for k in range(len(places))])
    late = norms(places - wanted)[500:]
    assert np.median(late) < 0.1 * 0.010 * turn / rate + 2e-5  # a tenth of the way between two words, or 20 um
