"""Setpoints that follow goals within motion bounds, compared with analytic motions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.control.predictor import TargetState
from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, MotionBounds, SetpointRequest, StreamedTip, turn_bounds
from core.errors import DescriptionError

PERIOD = 0.002
REST = TargetState(np.zeros(3), np.zeros(3))


def run(pursuit, goals, start=REST):
    places = [start]
    for goal in goals:
        places.append(pursuit.step(places[-1], goal, PERIOD))
    return np.array([place.position for place in places]), np.array([place.velocity for place in places])


def check_bounds(pursuit, positions, velocities):
    assert np.linalg.norm(velocities, axis=1).max() <= pursuit.max_speed * (1.0 + 1e-9)
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() <= pursuit.max_acceleration * PERIOD * (1.0 + 1e-9)
    # The reported velocity is the actual velocity of the setpoint.
    np.testing.assert_allclose(
        np.diff(positions, axis=0), 0.5 * PERIOD * (velocities[1:] + velocities[:-1]), atol=1e-15
    )


@pytest.mark.parametrize(
    "bad",
    [
        {"max_speed": 0.0},
        {"max_acceleration": -1.0},
        {"rate": float("nan")},
        {"max_speed": float("inf")},
        {"braking": 1.1},
        {"reach": 0.0},
    ],
)
def test_invalid_motion_bounds_are_refused_by_name(bad):
    with pytest.raises(DescriptionError, match=next(iter(bad))):
        MotionBounds(**{"max_speed": 0.02, "max_acceleration": 0.1, **bad})


def test_setpoint_stops_before_its_reach_and_slides_along_it():
    pursuit = MotionBounds(0.02, 0.1, reach=0.03)
    outside = TargetState(np.array([0.05, 0.0, 0.0]), np.zeros(3))

    positions, velocities = run(pursuit, [outside] * 2500)
    check_bounds(pursuit, positions, velocities)
    assert 0.0299 < positions[-1, 0] <= 0.03 + 1e-9

    aside = TargetState(np.array([0.05, 0.05, 0.0]), np.zeros(3))
    positions, _ = run(pursuit, [aside] * 5000, TargetState(positions[-1], velocities[-1]))
    # the setpoint turns with a bounded acceleration, so it may exceed the reach by 0.1 mm
    assert np.linalg.norm(positions, axis=1).max() <= 0.03 + 1e-4
    assert positions[-1] == pytest.approx(np.array([0.5, 0.5, 0.0]) * 0.03 * np.sqrt(2.0), abs=1e-4)


def test_setpoint_that_circles_along_its_reach_does_not_drift_outward():
    pursuit = MotionBounds(0.02, 0.1, reach=0.02)
    turns = [TargetState(0.04 * np.array([np.cos(t), np.sin(t), 0.0]), np.zeros(3)) for t in np.arange(0.0, 60.0, 2e-3)]

    positions, _ = run(pursuit, turns)

    away = np.linalg.norm(positions, axis=1)[10_000:]
    assert away.max() <= 0.02 + 2e-4
    assert away[-1000:].max() == pytest.approx(away[:5000].max(), abs=2e-5)


@given(
    speed=st.floats(1e-3, 0.1),
    acceleration=st.floats(1e-3, 1.0),
    reach=st.floats(1e-3, 0.2),
    seed=st.integers(0, 2**32),
    moving=st.booleans(),
)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_setpoint_never_leaves_its_reach_for_any_goal_and_bounds(speed, acceleration, reach, seed, moving):
    pursuit, random = MotionBounds(speed, acceleration, 20.0, 0.8, reach), np.random.default_rng(seed)
    goals = []
    for _ in range(30):
        place, velocity = random.normal(size=(2, 3))
        place *= reach * random.uniform(0.5, 1.5) / np.linalg.norm(place)
        velocity *= moving * speed / np.linalg.norm(velocity)
        goals += [TargetState(place, velocity)] * int(random.integers(1, 60))

    positions, velocities = run(pursuit, goals)

    check_bounds(pursuit, positions, velocities)
    # The setpoint can stop only at the end of a period, not within a period.
    assert np.linalg.norm(positions, axis=1).max() <= 1.0001 * reach + acceleration * PERIOD**2


STILL = np.zeros(3)


def follow(tip: StreamedTip, request, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (k, 3) of the setpoint; `request(time)` returns the request at a time."""
    setpoints = [tip.advance(PERIOD * k, request(PERIOD * k), PERIOD) for k in range(round(seconds / PERIOD))]
    return np.array([s.position for s in setpoints]), np.array([s.velocity for s in setpoints])


def norms(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=1)


def kept(velocities: np.ndarray) -> bool:
    """Return whether a setpoint that starts at rest keeps its bounds on speed and acceleration."""
    changes = np.diff(velocities, axis=0, prepend=0.0)
    return bool((norms(velocities) < 0.020 + 1e-12).all() and (norms(changes) < 0.100 * PERIOD + 1e-12).all())


def test_setpoint_reaches_a_jumping_requested_position_within_its_bounds_without_overshoot():
    position = np.array([0.030, 0.0, 0.0])
    positions, velocities = follow(
        StreamedTip(DEFAULT_MOTION_BOUNDS), lambda _: SetpointRequest(position, STILL, 0.0, 0.1), 3.0
    )

    assert kept(velocities)
    assert positions[:, 0].max() <= 0.030 + 1e-9
    assert positions[-1] == pytest.approx(position, abs=1e-7)
    # The motion takes 1.7 s with the full acceleration: both ramps take 0.2 s and 2 mm.
    arrived = PERIOD * np.argmax(positions[:, 0] > 0.0299)
    assert 1.6 < arrived < 2.0


def test_setpoint_follows_a_moving_requested_position_without_lag_once_reached():
    velocity = np.array([0.0, 0.010, 0.0])
    positions, velocities = follow(
        StreamedTip(DEFAULT_MOTION_BOUNDS), lambda t: SetpointRequest(velocity * t, velocity, t, 0.1), 2.0
    )

    assert kept(velocities)
    assert positions[-1] == pytest.approx(velocity * 2.0, abs=1e-6)


def test_requested_velocity_is_reached_at_full_acceleration_and_ends_before_the_reach():
    velocity = np.array([0.0, 0.0, 0.020])
    positions, velocities = follow(
        StreamedTip(DEFAULT_MOTION_BOUNDS), lambda t: SetpointRequest(None, velocity, t, 0.1), 5.0
    )

    assert kept(velocities)
    assert PERIOD * (1 + np.argmax(norms(velocities) > 0.020 - 1e-9)) == pytest.approx(0.2, abs=2 * PERIOD)
    assert 0.0499 < positions[-1, 2] <= 0.050 + 1e-9


def test_setpoint_without_requests_comes_to_rest_as_soon_as_possible():
    tip = StreamedTip(DEFAULT_MOTION_BOUNDS)
    follow(tip, lambda t: SetpointRequest(None, np.array([0.020, 0.0, 0.0]), t, 0.1), 1.0)
    positions, _ = follow(tip, lambda _: None, 0.5)

    # The braking distance is speed^2 / (2 a), within the distance of one period.
    assert positions[-1, 0] - positions[0, 0] == pytest.approx(0.002, abs=2 * 0.020 * PERIOD)
    assert tip.speed == 0.0


def test_requested_position_is_extrapolated_for_its_time_and_is_the_goal_again_afterwards():
    velocity = np.array([0.010, 0.0, 0.0])
    positions, _ = follow(StreamedTip(DEFAULT_MOTION_BOUNDS), lambda _: SetpointRequest(STILL, velocity, 0.0, 0.5), 3.0)

    # The setpoint moves at 10 mm/s for 0.5 s, and by its braking distance.
    assert 0.004 < positions[:, 0].max() < 0.010 * 0.5 + 0.010**2 / (2 * 0.100) + 1e-6
    assert positions[-1] == pytest.approx(STILL, abs=1e-6)


@given(velocity=st.tuples(*[st.floats(-1e3, 1e3)] * 3), goes_on=st.floats(0.0, 2.0), now=st.floats(-1.0, 1e6))
def test_goal_never_leaves_the_requested_position_by_more_than_its_extrapolation_and_returns(velocity, goes_on, now):
    position, velocity = np.array([0.001, 0.0, -0.002]), np.array(velocity)
    goal = SetpointRequest(position, velocity, 0.0, goes_on).goal(now, STILL)
    assert math.dist(goal.position, position) <= goes_on * math.hypot(*velocity) * (1.0 + 1e-9)
    if now >= goes_on:
        assert goal.position.tolist() == position.tolist()
        assert not goal.velocity.any()


@pytest.mark.parametrize("rate", [10.0, 500.0])
def test_circle_requested_in_pieces_with_gaps_is_followed_smoothly(rate):
    turn = 2.0 * math.pi / 20.0
    rng = np.random.default_rng(7)

    def circle(time: float) -> np.ndarray:
        return 0.010 * np.array([math.cos(turn * time) - 1.0, math.sin(turn * time), 0.0])

    requests = [SetpointRequest(STILL, STILL, 0.0, 1.0 / rate)]

    def request(time: float) -> SetpointRequest:
        if rate * time >= rate * requests[-1].time + 1.0 - 1e-9 and rng.random() > 0.1:
            position = circle(time)
            requests.append(
                SetpointRequest(
                    position, (position - requests[-1].position) / (time - requests[-1].time), time, 1.0 / rate
                )
            )
        return requests[-1]

    positions, velocities = follow(StreamedTip(DEFAULT_MOTION_BOUNDS), request, 20.0)

    assert kept(velocities)
    desired = np.array([circle(PERIOD * (k + 1)) for k in range(len(positions))])
    late = norms(positions - desired)[500:]
    assert np.median(late) < 0.1 * 0.010 * turn / rate + 2e-5  # a tenth of the distance between two requests, or 20 um


FASTEST = 0.2  #: rad/s
UP = np.array([0.0, 0.0, 1.0])


def pointed(requested, seconds: float, tip: StreamedTip | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return directions and angular velocities (k, 3); `requested(time)` returns the requested direction or None."""
    tip = tip or StreamedTip(DEFAULT_MOTION_BOUNDS, turn_bounds(FASTEST), UP)
    directions, rates = [], []
    for k in range(round(seconds / PERIOD)):
        direction = requested(PERIOD * k)
        request = None if direction is None else SetpointRequest(STILL, STILL, PERIOD * k, 0.1, direction)
        setpoint = tip.advance(PERIOD * k, request, PERIOD)
        assert setpoint.direction is not None
        directions.append(setpoint.direction)
        rates.append(setpoint.turning)
    return np.array(directions), np.array(rates)


def tilted(angle: float, about: float) -> np.ndarray:
    """Return the direction that is tilted from z by `angle` [rad] toward the azimuth `about` [rad] from x."""
    return np.array([math.sin(angle) * math.cos(about), math.sin(angle) * math.sin(about), math.cos(angle)])


def angles(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(ones, others), axis=-1), (ones * others).sum(axis=-1))


def turns_as_it_says(directions: np.ndarray, rates: np.ndarray) -> bool:
    """Return whether directions keep their motion bounds and rotate with the reported angular velocity."""
    assert norms(directions) == pytest.approx(np.ones(len(directions)), abs=1e-12)
    assert norms(rates).max() < FASTEST + 1e-12
    assert norms(np.diff(rates, axis=0, prepend=0.0)).max() < 5.0 * FASTEST * PERIOD * (1.0 + 1e-3)
    # The velocity of a unit vector is the cross product of its angular velocity and the vector, here between two ticks.
    moved = np.diff(directions, axis=0) / PERIOD
    means = np.cross(0.5 * (rates[1:] + rates[:-1]), 0.5 * (directions[1:] + directions[:-1]))
    return bool(np.abs(moved - means).max() < 1e-6)


def test_requested_direction_is_reached_along_the_shortest_arc_within_the_bounds() -> None:
    requested = tilted(1.0, 0.7)
    directions, rates = pointed(lambda _: requested, 7.0)

    assert turns_as_it_says(directions, rates)
    assert directions[-1] == pytest.approx(requested, abs=1e-7)
    # The direction never leaves the arc, turns back or overshoots.
    assert np.abs(directions @ np.cross(UP, requested)).max() < 1e-6
    assert (np.diff(angles(directions, requested)) < 1e-9).all()
    # The rotation by 1 rad at 0.2 rad/s has a ramp of 0.2 s at both ends and an exponential approach.
    arrived = PERIOD * np.argmax(angles(directions, requested) < 1e-3)
    assert 5.1 < arrived < 5.6


def test_new_requested_direction_during_a_rotation_is_approached_from_the_present_direction() -> None:
    one, other = tilted(0.5, 0.0), tilted(0.5, 2.0)
    directions, rates = pointed(lambda t: one if t < 1.5 else other, 8.0)

    assert turns_as_it_says(directions, rates)
    assert angles(directions[749], one) > 0.1  # the first rotation is not finished at 1.5 s
    assert directions[-1] == pytest.approx(other, abs=1e-7)


@pytest.mark.parametrize("off", [0.0, 1e-10, 1e-3])
def test_opposite_requested_direction_is_reached_by_half_a_turn(off: float) -> None:
    requested = tilted(math.pi - off, 0.3)
    directions, rates = pointed(lambda _: requested, 18.0)

    assert np.isfinite(directions).all()
    assert turns_as_it_says(directions, rates)
    assert directions[-1] == pytest.approx(requested, abs=1e-6)
    # The direction turns by half a turn and no more, although at the start all rotations are equally long.
    assert norms(rates).sum() * PERIOD == pytest.approx(math.pi, abs=2e-3)
    if off > 1e-7:
        assert np.abs(directions @ np.array([-math.sin(0.3), math.cos(0.3), 0.0])).max() < 1e-4


def test_slowly_moving_requested_direction_is_followed_within_the_expected_lag() -> None:
    # The requests resemble those of an operator's hand: 3 degrees per second, 50 requests per second.
    rate = math.radians(3.0)
    directions, rates = pointed(lambda t: tilted(rate * math.floor(t * 50.0) / 50.0, 0.0), 10.0)

    assert turns_as_it_says(directions, rates)
    desired = np.array([tilted(rate * PERIOD * (k + 1), 0.0) for k in range(len(directions))])
    # The error decays with a rate of 20 /s, and the newest request is up to 20 ms old.
    assert angles(directions, desired)[500:].max() < rate * (1.0 / 20.0 + 0.025)


def test_streamed_direction_without_requests_comes_to_rest_and_stays() -> None:
    requested, tip = tilted(1.0, 0.7), StreamedTip(DEFAULT_MOTION_BOUNDS, turn_bounds(FASTEST), UP)
    before, _ = pointed(lambda _: requested, 2.0, tip)
    assert tip.turning == pytest.approx(FASTEST)
    after, rates = pointed(lambda _: None, 1.0, tip)

    assert tip.turning == 0.0
    # The braking angle is rate^2 / (2 a), within the angle of one period.
    assert angles(before[-1], after[-1]) == pytest.approx(0.02, abs=2 * FASTEST * PERIOD)
    assert not rates[-200:].any()


def test_start_direction_is_kept_before_a_request_and_is_absent_when_the_direction_is_not_controlled() -> None:
    request = SetpointRequest(np.array([0.001, 0.0, 0.0]), STILL, 0.0, 0.1)
    kept = StreamedTip(DEFAULT_MOTION_BOUNDS, turn_bounds(FASTEST), UP).advance(0.0, request, PERIOD)
    absent = StreamedTip(DEFAULT_MOTION_BOUNDS).advance(0.0, request._replace(direction=tilted(1.0, 0.0)), PERIOD)
    assert kept.direction is not None
    assert kept.direction.tolist() == UP.tolist()
    assert absent.direction is None
    assert not kept.turning.any()
    assert not absent.turning.any()
