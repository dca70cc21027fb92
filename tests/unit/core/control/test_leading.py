"""A led tip against what bounded speed and acceleration allow, worked out by hand."""

import math

import numpy as np
import pytest

from core.control.leading import BOUNDS, LedTip, Wish, turns

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


FASTEST = 0.2  #: rad/s
UP = np.array([0.0, 0.0, 1.0])


def pointed(told, seconds: float, tip: LedTip | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Wanted directions and their angular velocities (k, 3); `told` is asked with the time, None is silence."""
    tip = tip or LedTip(BOUNDS, turns(FASTEST), UP)
    directions, rates = [], []
    for k in range(round(seconds / PERIOD)):
        direction = told(PERIOD * k)
        wish = None if direction is None else Wish(STILL, STILL, PERIOD * k, 0.1, direction)
        setpoint = tip.advance(PERIOD * k, wish, PERIOD)
        assert setpoint.direction is not None
        directions.append(setpoint.direction)
        rates.append(setpoint.turning)
    return np.array(directions), np.array(rates)


def tilted(angle: float, about: float) -> np.ndarray:
    """So far from up, toward so much round from x [rad]."""
    return np.array([math.sin(angle) * math.cos(about), math.sin(angle) * math.sin(about), math.cos(angle)])


def angles(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(ones, others), axis=-1), (ones * others).sum(axis=-1))


def turns_as_it_says(directions: np.ndarray, rates: np.ndarray) -> bool:
    """Unit vectors within the bounds of rate and acceleration, whose angular velocity is what is told of it."""
    assert norms(directions) == pytest.approx(np.ones(len(directions)), abs=1e-12)
    assert norms(rates).max() < FASTEST + 1e-12
    assert norms(np.diff(rates, axis=0, prepend=0.0)).max() < 5.0 * FASTEST * PERIOD * (1.0 + 1e-3)
    # the speed of a unit vector is its angular velocity times itself, here half way between two ticks
    moved = np.diff(directions, axis=0) / PERIOD
    means = np.cross(0.5 * (rates[1:] + rates[:-1]), 0.5 * (directions[1:] + directions[:-1]))
    return bool(np.abs(moved - means).max() < 1e-6)


def test_a_direction_that_was_told_is_turned_to_along_the_shortest_arc_no_faster_than_agreed() -> None:
    told = tilted(1.0, 0.7)
    directions, rates = pointed(lambda _: told, 7.0)

    assert turns_as_it_says(directions, rates)
    assert directions[-1] == pytest.approx(told, abs=1e-7)
    # On the way it is never off the arc, and never turns back or beyond.
    assert np.abs(directions @ np.cross(UP, told)).max() < 1e-6
    assert (np.diff(angles(directions, told)) < 1e-9).all()
    # 1 rad at 0.2 rad/s, with a ramp of 0.2 s at either end and the last of the way closed in on
    arrived = PERIOD * np.argmax(angles(directions, told) < 1e-3)
    assert 5.1 < arrived < 5.6


def test_another_direction_on_the_way_is_turned_to_from_there() -> None:
    one, other = tilted(0.5, 0.0), tilted(0.5, 2.0)
    directions, rates = pointed(lambda t: one if t < 1.5 else other, 8.0)

    assert turns_as_it_says(directions, rates)
    assert angles(directions[749], one) > 0.1  # not there yet
    assert directions[-1] == pytest.approx(other, abs=1e-7)


@pytest.mark.parametrize("off", [0.0, 1e-14, 1e-10, 1e-6, 1e-3])
def test_the_opposite_direction_is_reached_by_half_a_turn_one_way_or_another(off: float) -> None:
    told = tilted(math.pi - off, 0.3)
    directions, rates = pointed(lambda _: told, 18.0)

    assert np.isfinite(directions).all()
    assert turns_as_it_says(directions, rates)
    assert directions[-1] == pytest.approx(told, abs=1e-6)
    # half a turn and no more, although at its beginning no way is shorter than others
    assert norms(rates).sum() * PERIOD == pytest.approx(math.pi, abs=2e-3)
    if off > 1e-7:
        assert np.abs(directions @ np.array([-math.sin(0.3), math.cos(0.3), 0.0])).max() < 1e-4


def test_one_told_a_little_later_each_time_is_followed_within_its_lag() -> None:
    # as a hand does it: 3 degrees a second, 50 times a second
    rate = math.radians(3.0)
    directions, rates = pointed(lambda t: tilted(rate * math.floor(t * 50.0) / 50.0, 0.0), 10.0)

    assert turns_as_it_says(directions, rates)
    wanted = np.array([tilted(rate * PERIOD * (k + 1), 0.0) for k in range(len(directions))])
    # what is left shrinks at 20 /s, and the newest word is up to 20 ms old
    assert angles(directions, wanted)[500:].max() < rate * (1.0 / 20.0 + 0.025)


def test_silence_lets_it_come_to_rest_where_it_is_and_then_it_stays() -> None:
    told, tip = tilted(1.0, 0.7), LedTip(BOUNDS, turns(FASTEST), UP)
    before, _ = pointed(lambda _: told, 2.0, tip)
    assert tip.turning == pytest.approx(FASTEST)
    after, rates = pointed(lambda _: None, 1.0, tip)

    assert tip.turning == 0.0
    # rate^2 / (2 a), give or take the way of one period
    assert angles(before[-1], after[-1]) == pytest.approx(0.02, abs=2 * FASTEST * PERIOD)
    assert not rates[-200:].any()


def test_before_a_direction_was_told_that_of_the_start_is_kept() -> None:
    tip = LedTip(BOUNDS, turns(FASTEST), UP)
    setpoint = tip.advance(0.0, Wish(np.array([0.001, 0.0, 0.0]), STILL, 0.0, 0.1), PERIOD)
    assert setpoint.direction is not None
    assert setpoint.direction.tolist() == UP.tolist()
    assert not setpoint.turning.any()


def test_where_no_direction_is_controlled_none_is_asked_for() -> None:
    setpoint = LedTip(BOUNDS).advance(0.0, Wish(STILL, STILL, 0.0, 0.1, tilted(1.0, 0.0)), PERIOD)
    assert setpoint.direction is None
    assert not setpoint.turning.any()
